"""What tests do with `c_host/host.c`, which couples FMUs: its plans, its recordings."""

import math
import subprocess
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panda_cosim import Options, load_scenario
from panda_cosim.assets import STEP_SIZE
from panda_cosim.fmus.build.libraries import SOURCES, includes
from panda_cosim.fmus.build.platforms import PLATFORMS
from panda_cosim.fmus.interface.controller import COMMANDS
from panda_cosim.fmus.interface.tables import INTERFACES, TRAJECTORY
from panda_cosim.fmus.master.wiring import System
from panda_cosim.fmus.sources.targets import Kind, Target, build, build_trajectory
from panda_cosim.run.prepare import prepare
from panda_cosim.run.start import StartValues, instants, resolve, start_values

HOST = Path(__file__).parent / "c_host" / "host.c"
TABLES = {"trajectory": TRAJECTORY, "controller": INTERFACES["controller"],
          "plant": INTERFACES["plant"]}  # fmt: skip


def panda_system(asked: Sequence[str] = (), files: Mapping[str, Path] | None = None) -> System:
    """Plant and controller, with the commands as external inputs, recording also what is asked."""
    prepared = prepare(load_scenario("pick_and_place"), Options(fmus=files))
    return replace(prepared.assembly, asked=frozenset(asked)).system


@dataclass(frozen=True)
class Task:
    """A scenario as the host runs it: unpacked FMUs of one platform, and how they start."""

    fmi: int
    platform: str
    steps: int
    values: StartValues
    folders: Mapping[str, Path]

    def library(self, name: str) -> Path:
        """The library of an instance."""
        target, binaries = PLATFORMS[self.platform], self.folders[name] / "binaries"
        place = target.fmi2 if self.fmi == 2 else target.fmi3
        return binaries / place / f"{TABLES[name].model}{target.suffix}"


def unpack_task(
    scenario_name: str,
    fmi: int,
    platform: str,
    folder: Path,
    until: float | None = None,
    kind: Kind = "native",
) -> Task:
    """Build a scenario's FMUs for a platform and unpack them; `until` ends it earlier [s]."""
    scenario = load_scenario(scenario_name)
    scenario = replace(scenario, duration=until or scenario.duration)
    values = start_values(scenario)
    target = Target(kind, fmi, (platform,))
    files = build(target=target)
    table = resolve(scenario, values).sample(instants(scenario))
    files["trajectory"] = build_trajectory(table, target=target)
    for name, path in files.items():
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder / name)
    return Task(fmi, platform, scenario.ticks, values, {name: folder / name for name in files})


def write_plan(task: Task, path: Path, foreign: Callable[[Path], str] = str) -> list[str]:
    """Write the host's plan; returns the names of the recording's columns."""
    lines, columns = [f"fmi {task.fmi}"], _columns()
    at = {name: i for i, name in enumerate(columns)}
    for name, table in TABLES.items():
        resources = foreign(task.folders[name] / "resources").replace("\\", "/")
        if task.fmi == 2:
            resources = "file://" + "/" * (not resources.startswith("/")) + resources
        described = (task.folders[name] / "resources" / "variables.txt").read_text().splitlines()
        token = next(line.split("\t")[1] for line in described if line.startswith("token"))
        leads = "leads" if name == "controller" else "follows"
        lines.append(f"instance {leads} {foreign(task.library(name))} {token} {resources}")
        lines += _starts(list(TABLES).index(name), task, table, task.values.get(name, {}))
    for i, table in enumerate(TABLES.values()):
        outputs = [s for s in table.scalars() if s.variable.causality == "output"]
        lines.append(f"read {i} {len(outputs)} {_references(outputs, task.fmi)}")
    for i, (name, table) in enumerate(TABLES.items()):
        inputs = [s for s in table.scalars() if _source(name, s.name) in at]
        fed = " ".join(str(at[_source(name, s.name)]) for s in inputs)
        lines.append(f"feed {i} {len(inputs)} {fed} {_references(inputs, task.fmi)}")
    path.write_text("\n".join([*lines, f"run {task.steps} {STEP_SIZE.hex()}", ""]))
    return columns


def _columns() -> list[str]:
    """Outputs by the names that a recording has for them."""
    columns = []
    for name, table in TABLES.items():
        owner = "controller" if name == "trajectory" else name  # recorded as its inputs
        outputs = (s for s in table.scalars() if s.variable.causality == "output")
        columns += [f"{owner}.{s.name}" for s in outputs]
    return columns


def _source(instance: str, variable: str) -> str:
    """The column that feeds an input; "" for what is no input."""
    array = variable.partition("[")[0]
    table = TABLES[instance]
    if array not in {v.name for v in table.of("input")}:
        return ""
    if array in COMMANDS:
        return f"controller.{variable}"
    return f"{'plant' if instance == 'controller' else 'controller'}.{variable}"


def _begins(variable: Any) -> set[int]:
    """Elements with which the arrays of FMI 3.0 begin."""
    rows = [0, *(rows for _, rows, _ in variable.parts)][: len(variable.parts) or 1]
    width = math.prod(variable.shape[1:])
    return {width * row for row in accumulate(rows)}


def _references(scalars: Sequence[Any], fmi: int) -> str:
    """How many references, and these: of scalars in FMI 2.0, of whole arrays in FMI 3.0."""
    found = [s.value_reference for s in scalars if fmi == 2 or s.element in _begins(s.variable)]
    return " ".join(map(str, (len(found), *found)))


def _starts(instance: int, task: Task, table: Any, values: Mapping[str, Any]) -> Iterator[str]:
    """One line for each parameter that has a value."""
    given = [s for s in table.scalars() if s.name in values]
    for _, group in groupby(given, key=lambda s: s.variable.name):
        scalars = list(group)
        kind, names = scalars[0].variable.kind, ("", *scalars[0].variable.choices)
        numbers = [names.index(x) if x in names else x for x in (values[s.name] for s in scalars)]
        words = " ".join(float(x).hex() for x in numbers)
        yield f"start {instance} {kind} {len(numbers)} {words} {_references(scalars, task.fmi)}"


def compile_host(program: Path, *tool: str) -> None:
    """Compile the host as the libraries are: ziglang has by folder and flags what Windows needs."""
    folders = [f"-isystem{folder}" for folder in includes()]
    libraries = [] if program.suffix == ".exe" else ["-ldl", "-lpthread"]
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-O1", "-s"]
    command = [*tool, *flags, *folders, str(HOST), "-o", str(program), *libraries]
    subprocess.run(command, cwd=SOURCES, check=True, timeout=300)


def read_rows(path: Path, columns: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """What the host has recorded, by column."""
    rows = np.fromfile(path).reshape(-1, len(columns))
    return dict(zip(columns, rows.T, strict=True))
