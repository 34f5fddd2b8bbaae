"""Unpacked FMUs, and instances of them in FMI 2.0 and FMI 3.0 by ctypes."""

import ctypes
import random
import shutil
import struct
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from math import prod
from pathlib import Path
from typing import Any
from urllib.parse import quote

import mujoco
import numpy as np

from panda_cosim.fmus.build.native import NativeFmu, table
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.model_fmu import ModelOptions, model_fmu
from panda_cosim.fmus.sources.targets import Kind, Target, build, build_fmu, build_trajectory

STEP = 0.001  # [s]
OK, WARNING, DISCARD, ERROR = range(4)
MJCF = Path(__file__).parent / "mjcf" / "sleeping.xml"
BACKENDS = {"plant": "mujoco", "controller": "controller", "trajectory": "player", "mjcf": "mujoco"}
MODELS: list[tuple[Kind, str]] = [
    *(("native", name) for name in BACKENDS),
    *(("python", name) for name in ("plant", "controller", "trajectory", "sensors")),
]


@dataclass(frozen=True)
class Row:
    """A variable; the fields are those of fmus/README.md."""

    reference: int
    shape: tuple[int, ...]
    causality: str
    variability: str
    kind: str
    name: str
    start: tuple[float, ...]
    sizes: tuple[int, ...]  # of its arrays in FMI 3.0

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def arrays(self) -> list[tuple[int, int]]:
        """Reference and size of each array in FMI 3.0."""
        firsts = accumulate(self.sizes, initial=self.reference)
        return list(zip(firsts, self.sizes, strict=False))


@dataclass(frozen=True)
class Unpacked:
    """An unpacked FMU."""

    folder: Path

    @cached_property
    def version(self) -> int:
        """Major version of FMI."""
        description = (self.folder / "modelDescription.xml").read_text(encoding="utf-8")
        return 3 if 'fmiVersion="3.0"' in description else 2

    @property
    def library(self) -> Path:
        """Its shared library."""
        files = (self.folder / "binaries").glob("*/*")
        return next(path for path in files if "mujoco" not in path.name)

    @property
    def location(self) -> str:
        """Where its resources are, as the standard wants it."""
        resources = f"{self.folder}/resources"
        return f"file://{quote(resources)}" if self.version == 2 else f"{resources}/"

    @property
    def table(self) -> Path:
        """The file that describes it for its library."""
        return self.folder / "resources" / "variables.txt"

    def _records(self, kind: str) -> list[list[str]]:
        lines = [line.split("\t") for line in self.table.read_text(encoding="utf-8").splitlines()]
        return [fields[1:] for fields in lines if fields[0] == kind]

    @property
    def token(self) -> str:
        """GUID or instantiation token."""
        return self._records("token")[0][0]

    @cached_property
    def rows(self) -> dict[str, Row]:
        """Variables by name."""
        rows = [_row(fields[10], *fields[:7]) for fields in self._records("variable")]
        return {row.name: row for row in rows}

    def names(self, causality: str) -> list[str]:
        """Variables of type Real."""
        chosen = [row for row in self.rows.values() if row.causality == causality]
        return [row.name for row in chosen if row.kind == "Real"]

    def reals(self, causality: str) -> str:
        """Variables of type Real, as `reference:size,...`."""
        rows = [self.rows[name] for name in self.names(causality)]
        wholes = [[(row.reference, row.size)] if self.version == 2 else row.arrays for row in rows]
        return ",".join(f"{first}:{size}" for whole in wholes for first, size in whole)

    @property
    def size(self) -> int:
        """Number of values."""
        return sum(row.size for row in self.rows.values())

    def copy(self, folder: Path, change: Callable[[str], str] = str) -> "Unpacked":
        """Copy it, with another table."""
        shutil.copytree(self.folder, folder)
        other = Unpacked(folder)
        other.table.write_text(change(self.table.read_text(encoding="utf-8")), encoding="utf-8")
        return other


def _row(arrays: str, *fields: str) -> Row:
    reference, shape, causality, variability, kind, name, start = fields
    sizes = () if shape == "-" else tuple(map(int, shape.split("x")))
    numbers = [] if start == "-" or kind == "String" else start.split()
    values = tuple(struct.unpack(">d", bytes.fromhex(number))[0] for number in numbers)
    values = values * prod(sizes) if len(values) == 1 else values
    parts = (prod(sizes),) if arrays == "-" else tuple(map(int, arrays.split()))
    return Row(int(reference), sizes, causality, variability, kind, name, values, parts)


@cache
def unpacked(kind: Kind, name: str, version: int) -> Unpacked:
    """One of the project's own FMUs, or that of a model of others (`mjcf`)."""
    target = Target(kind, version)
    if name == "mjcf":
        return unpacked_fmu(model_fmu(MJCF, ModelOptions(), "Other"), version)
    if name == "trajectory":
        commands = np.random.default_rng(1).standard_normal((50, 14))
        return Unpacked(Fmu(build_trajectory(commands, target=target)).folder)
    return Unpacked(Fmu(build((name,), target=target)[name]).folder)


def mujoco_library() -> Path:
    """MuJoCo's library, as its package brings it."""
    return next(Path(mujoco.__file__).parent.glob("libmujoco.*"))


def unpacked_fmu(fmu: NativeFmu, version: int = 2) -> Unpacked:
    """Build an FMU, and unpack it."""
    return Unpacked(Fmu(build_fmu(fmu, target=Target(fmi=version))).folder)


def with_content(fmu: NativeFmu, folder: Path, version: int) -> Unpacked:
    """The FMU of a model (mjcf) with the table and resources of another one: fast to make."""
    content = table(fmu.interface, fmu.digest, fmu.step_size, fmu.options).decode()
    place = unpacked("native", "mjcf", version).copy(folder, lambda _: content)
    for name, resource in fmu.resources.items():
        (place.folder / "resources" / name).write_bytes(resource)
    return place


_LOG2 = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_LOG3 = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class _Callbacks(ctypes.Structure):
    _rest = ("allocate", "free", "finished", "environment")
    _fields_ = (("logger", _LOG2), *zip(_rest, [c_void_p] * 4, strict=True))


_FUNCTIONS: dict[int, dict[str, tuple[str, Any]]] = {
    2: {"Real": ("Real", c_double), "Boolean": ("Boolean", c_int), "Integer": ("Integer", c_int),
        "Enumeration": ("Integer", c_int), "String": ("String", c_char_p)},
    3: {"Real": ("Float64", c_double), "Boolean": ("Boolean", c_bool),
        "Integer": ("Int32", ctypes.c_int32), "Enumeration": ("Int64", ctypes.c_int64),
        "String": ("String", c_char_p)},
}  # fmt: skip


class RefusedError(AssertionError):
    """An FMU that cannot be instantiated; the message is what it has logged."""


class Instance:
    """An instance that keeps what it logs, and returns the status of each call."""

    def __init__(
        self, fmu: Unpacked, location: str | None = None, token: str | None = None
    ) -> None:
        self.dll = ctypes.CDLL(str(fmu.library))
        self.fmu, self.version = fmu, fmu.version
        self.log: list[tuple[int, str, str]] = []
        where = fmu.location if location is None else location
        self.c = c_void_p(self._instantiate(where.encode(), (token or fmu.token).encode()))
        if not self.c:
            raise RefusedError(self.messages())

    def _instantiate(self, location: bytes, token: bytes) -> int | None:
        if self.version == 2:
            self.logger: Any = _LOG2(self._log)
            self.callbacks = _Callbacks(self.logger)
            create: Any = self.dll.fmi2Instantiate
            arguments: tuple[Any, ...] = (b"it", 1, token, location, byref(self.callbacks), 0, 1)
        else:
            self.logger = _LOG3(self._log)
            create = self.dll.fmi3InstantiateCoSimulation
            modes, none = [c_bool(False)] * 4, c_size_t(0)
            arguments = (b"it", token, location, *modes, None, none, None, self.logger, None)
        create.restype = c_void_p
        component: int | None = create(*arguments)
        return component

    def _log(self, *said: Any) -> None:
        status, category, text = *said[-3:-1], said[-1].decode()
        text = text.replace("%%", "%") if self.version == 2 else text
        self.log.append((status, category.decode(), text))

    def messages(self) -> str:
        """All that has been logged."""
        return "\n".join(text for _, _, text in self.log)

    def __call__(self, name: str, *arguments: Any) -> int:
        """Call a function of the standard without its prefix."""
        status: int = self.dll[f"fmi{self.version}{name}"](self.c, *arguments)
        return status

    def start(
        self, values: Mapping[str, Sequence[float]] | None = None, **times: Any
    ) -> "Instance":
        """Set variables and go through initialization, which has to succeed; times as `enter`."""
        for name, elements in (values or {}).items():
            assert self.set(name, *elements) == OK, self.messages()
        assert self.enter(**times) == OK, self.messages()
        assert self("ExitInitializationMode") == OK, self.messages()
        return self

    def enter(self, start_time: float = 0.0, stop_time: float | None = None) -> int:
        """Enter initialization mode."""
        has_stop, stop = c_int(stop_time is not None), c_double(stop_time or 0.0)
        times = (c_int(0), c_double(0), c_double(start_time), has_stop, stop)
        if self.version == 3:
            return self("EnterInitializationMode", *times)
        return max(self("SetupExperiment", *times), self("EnterInitializationMode"))

    def step(self, time: float, size: float = STEP) -> int:
        """Take a communication step."""
        if self.version == 2:
            return self("DoStep", c_double(time), c_double(size), 1)
        self.event, self.terminate, self.early = c_bool(True), c_bool(True), c_bool(True)
        self.last = c_double(-1.0)
        return self("DoStep", c_double(time), c_double(size), c_bool(True), byref(self.event),
                    byref(self.terminate), byref(self.early), byref(self.last))  # fmt: skip

    def steps(self, count: int, first: int = 0) -> None:
        """Take steps of one internal step, which have to succeed."""
        for i in range(first, first + count):
            assert self.step(i * STEP) == OK, self.messages()

    def set(self, name: str, *values: Any) -> int:
        """Set all elements of a variable."""
        return self.set_references(self._references(name), values, self.fmu.rows[name].kind)

    def set_references(
        self, references: Sequence[int], values: Sequence[Any], kind: str = "Real"
    ) -> int:
        """Set by value references."""
        name, c_type = _FUNCTIONS[self.version][kind]
        cast = int if kind == "Enumeration" else bytes if kind == "String" else c_type
        return self._access(f"Set{name}", references, (c_type * len(values))(*map(cast, values)))

    def get(self, name: str) -> list[Any]:
        """Values of all elements of a variable."""
        row = self.fmu.rows[name]
        status, values = self.get_references(self._references(name), row.size, row.kind)
        assert status == OK, self.messages()
        return values

    def get_references(
        self, references: Sequence[int], count: int, kind: str = "Real"
    ) -> tuple[int, list[Any]]:
        """Status and values by value references."""
        name, c_type = _FUNCTIONS[self.version][kind]
        values = (c_type * count)()
        return self._access(f"Get{name}", references, values), list(values)

    def _access(self, function: str, references: Sequence[int], values: Any) -> int:
        count = (c_size_t(len(values)),) if self.version == 3 else ()
        array = (c_uint * len(references))(*references)
        return self(function, array, c_size_t(len(references)), values, *count)

    def _references(self, name: str) -> list[int]:
        row = self.fmu.rows[name]
        if self.version == 3:
            return [first for first, _ in row.arrays]
        return [row.reference + i for i in range(row.size)]

    def outputs(self) -> list[float]:
        """Values of all outputs of type Real."""
        return [value for name in self.fmu.names("output") for value in self.get(name)]

    def set_inputs(self, values: Sequence[float]) -> None:
        """Set all inputs."""
        at = 0
        for name in self.fmu.names("input"):
            size = self.fmu.rows[name].size
            assert self.set(name, *values[at : at + size]) == OK, self.messages()
            at += size

    def play(self, first: int, count: int) -> list[list[float]]:
        """Step with inputs that depend on the tick alone; returns the outputs after each step."""
        rows = []
        for tick in range(first, first + count):
            self.play_unread(tick)
            rows.append(self.outputs())
        return rows

    def play_unread(self, tick: int) -> None:
        """Take the step of a tick as `play` does, and read nothing."""
        source, inputs = random.Random(tick), []
        for name in self.fmu.names("input"):
            inputs += [start + 0.02 * source.random() for start in self.fmu.rows[name].start]
            if name in ("grip_cmd", "ctrl"):
                inputs[-1] = self.fmu.rows[name].start[-1] * source.random()
        self.set_inputs(inputs)
        self.steps(1, tick)

    # States.

    def _state(self, function: str, *arguments: Any) -> int:
        return self(function if self.version == 3 else function.replace("State", "state"),
                    *arguments)  # fmt: skip

    def save(self) -> c_void_p:
        """Get a state."""
        state = c_void_p()
        assert self._state("GetFMUState", byref(state)) == OK, self.messages()
        return state

    def load(self, state: c_void_p) -> int:
        """Set a state."""
        return self._state("SetFMUState", state)

    def drop(self, state: c_void_p) -> int:
        """Free a state."""
        return self._state("FreeFMUState", byref(state))

    def serialize(self, state: c_void_p) -> bytes:
        """A state as bytes."""
        size = c_size_t()
        assert self._state("SerializedFMUStateSize", state, byref(size)) == OK, self.messages()
        content = (ctypes.c_ubyte * size.value)()
        assert self._state("SerializeFMUState", state, content, size) == OK, self.messages()
        return bytes(content)

    def deserialize(self, content: bytes) -> tuple[int, c_void_p]:
        """Status, and a state from bytes."""
        state = c_void_p()
        name = "DeSerializeFMUState" if self.version == 2 else "DeserializeFMUState"
        buffer = (ctypes.c_ubyte * len(content)).from_buffer_copy(content) if content else None
        return self._state(name, buffer, c_size_t(len(content)), byref(state)), state

    def free(self) -> None:
        """Free the instance."""
        self("FreeInstance")
