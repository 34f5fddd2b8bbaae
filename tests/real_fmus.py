"""The FMUs that users get, unpacked, and what hosts in C need to know of them."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from native_support import resources_uri
from panda_cosim.fmus.sources.model_fmu import ModelOptions, model_fmu
from panda_cosim.fmus.sources.targets import Kind, Target, build, build_fmu, build_trajectory

MJCF = Path(__file__).parent / "mjcf" / "sleeping.xml"
NAMES = {"plant": "PandaPlant", "controller": "PandaController", "sensors": "PandaSensors",
         "trajectory": "PandaTrajectory", "mjcf": "Other"}  # fmt: skip
BACKENDS = {"plant": "mujoco", "controller": "controller", "trajectory": "player", "mjcf": "mujoco"}
MODELS: list[tuple[Kind, str]] = [
    *(("native", name) for name in BACKENDS),
    *(("python", name) for name in ("plant", "controller", "trajectory", "sensors")),
]


@dataclass(frozen=True)
class RealFmu:
    """An unpacked FMU."""

    folder: Path
    model: str
    backend: str  # key of `compile.BACKENDS`, or "python"
    version: int  # major, of FMI

    @property
    def library(self) -> Path:
        """Its shared library."""
        return next((self.folder / "binaries").glob(f"*/{self.model}.so"))

    @property
    def location(self) -> str:
        """Where its resources are, as the standard wants it."""
        return resources_uri(self.folder) if self.version == 2 else f"{self.folder}/resources/"

    def records(self, kind: str) -> list[list[str]]:
        """Fields of records of resources/variables.txt."""
        text = (self.folder / "resources" / "variables.txt").read_text(encoding="utf-8")
        return [line.split("\t") for line in text.splitlines() if line.startswith(f"{kind}\t")]

    @property
    def token(self) -> str:
        """GUID or instantiation token."""
        return self.records("token")[0][1]

    @property
    def size(self) -> int:
        """Number of values."""
        return sum(_size(fields[2]) for fields in self.records("variable"))

    def reals(self, causality: str) -> str:
        """Variables of type Real, as `reference:size,...`."""
        rows = [row for row in self.records("variable") if (row[3], row[5]) == (causality, "Real")]
        return ",".join(f"{row[1]}:{_size(row[2])}" for row in rows)


def _size(shape: str) -> int:
    return 1 if shape == "-" else int(np.prod([int(n) for n in shape.split("x")]))


def real_fmu(folder: Path, kind: Kind, name: str, version: int) -> RealFmu:
    """Build one of `NAMES`, or take it from the cache, and unpack it into a new folder."""
    target = Target(kind, version)
    folder.mkdir(parents=True)
    if name == "mjcf":
        path = build_fmu(model_fmu(MJCF, ModelOptions(), "Other"), folder / "Other.fmu", target)
    elif name == "trajectory":
        commands = np.random.default_rng(1).standard_normal((50, 14))
        path = build_trajectory(commands, target=target)
    else:
        path = build((name,), target=target)[name]
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "fmu")
    return RealFmu(
        folder / "fmu", NAMES[name], BACKENDS[name] if kind == "native" else "python", version
    )
