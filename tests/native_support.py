"""What the tests of native FMUs share: unpacked FMUs, and FMI 2.0 and FMI 3.0 by ctypes."""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
from collections.abc import Mapping, Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from math import prod
from pathlib import Path
from typing import Any
from urllib.parse import quote

from panda_cosim.fmus.build.libraries import PLATFORMS, library, this_platform

TOKEN = "{11111111-2222-3333-4444-555555555555}"
STEP = 0.001  # [s]
OK, WARNING, DISCARD, ERROR = range(4)
COMMA = 'LC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n'


def bits(*numbers: float) -> str:
    """Numbers as they stand in a table."""
    return " ".join(struct.pack(">d", x).hex() for x in numbers) if numbers else "-"


def encoded(text: str) -> str:
    """A text as it stands in a table."""
    return "".join(f"%{ord(c):02x}" if c in "%\t\n\r" else c for c in text) or "-"


@dataclass(frozen=True)
class Row:
    """A variable of a table; the fields are those of fmus/native/README.md."""

    name: str
    causality: str = "output"
    shape: tuple[int, ...] = ()
    source: str = ""
    variability: str = "continuous"
    kind: str = "Real"
    start: tuple[float, ...] | str = ()
    minimum: tuple[float, ...] = ()
    maximum: tuple[float, ...] = ()

    def line(self, reference: int) -> str:
        """The record."""
        start = encoded(self.start) if isinstance(self.start, str) else bits(*self.start)
        shape = "x".join(map(str, self.shape)) or "-"
        fields = ("variable", str(reference), shape, self.causality, self.variability, self.kind,
                  encoded(self.name), start, bits(*self.minimum), bits(*self.maximum),
                  encoded(self.source))  # fmt: skip
        return "\t".join(fields)


TIME = Row("time", "independent")


def parameter(
    name: str, *start: float, source: str = "", tunable: bool = False, **more: Any
) -> Row:
    """A parameter; a vector if it has several start values."""
    shape = more.pop("shape", (len(start),) if len(start) > 1 else ())
    return Row(
        name, "parameter", shape, source, "tunable" if tunable else "fixed", start=start, **more
    )


@dataclass(frozen=True)
class Table:
    """What resources/variables.txt says."""

    rows: tuple[Row, ...]
    options: tuple[tuple[str, str], ...] = ()
    step: float = STEP
    token: str = TOKEN
    references: dict[str, int] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        at = 0
        for row in self.rows:
            self.references[row.name] = at
            at += prod(row.shape)

    def text(self) -> str:
        """The file."""
        head = ["fmu\t1", f"token\t{self.token}", f"step\t{bits(self.step)}"]
        options = [f"option\t{key}\t{encoded(value)}" for key, value in self.options]
        rows = [row.line(self.references[row.name]) for row in self.rows]
        return "\n".join([*head, *options, *rows, ""])

    @property
    def size(self) -> int:
        """Number of values."""
        return sum(prod(row.shape) for row in self.rows)

    def row(self, name: str) -> Row:
        """The variable of a name."""
        return next(row for row in self.rows if row.name == name)

    def elements(self, name: str) -> list[int]:
        """Value references of all elements of a variable."""
        first = self.references[name]
        return list(range(first, first + prod(self.row(name).shape)))


@cache
def library_of(backend: str) -> bytes:
    """A backend's library as FMUs get it: the package's, or one that is compiled once for all."""
    return library(backend, this_platform()).read_bytes()


def mujoco_library() -> Path:
    """MuJoCo's library, as its package brings it."""
    spec = find_spec("mujoco")
    assert spec
    assert spec.origin
    return next(Path(spec.origin).parent.glob("libmujoco.*"))


def unpacked(
    folder: Path,
    backend: str,
    table: Table,
    resources: Mapping[str, bytes],
    model: str = "Model",
    library: bytes | None = None,
) -> Path:
    """Write an unpacked FMU; returns its folder."""
    platform = PLATFORMS[this_platform()]
    for place in {platform.fmi2, platform.fmi3}:
        binaries = folder / "binaries" / place
        binaries.mkdir(parents=True)
        (binaries / f"{model}{platform.suffix}").write_bytes(library or library_of(backend))
        if backend in ("mujoco", "controller"):
            (binaries / platform.mujoco).symlink_to(mujoco_library())
    (folder / "resources").mkdir()
    (folder / "resources" / "variables.txt").write_text(table.text(), encoding="utf-8")
    for name, content in resources.items():
        (folder / "resources" / name).write_bytes(content)
    return folder


def resources_uri(folder: Path) -> str:
    """URI of an unpacked FMU's resources."""
    return "file://" + quote(str(folder / "resources"))


_LOG2 = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_LOG3 = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOG2),
        ("allocate", c_void_p),
        ("free", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    )


_FUNCTIONS2 = {
    "Real": ("Real", c_double),
    "Boolean": ("Boolean", c_int),
    "Integer": ("Integer", c_int),
    "Enumeration": ("Integer", c_int),
    "String": ("String", c_char_p),
}
_FUNCTIONS3 = {
    "Real": ("Float64", c_double),
    "Boolean": ("Boolean", c_bool),
    "Integer": ("Int32", ctypes.c_int32),
    "Enumeration": ("Int64", ctypes.c_int64),
    "String": ("String", c_char_p),
}


class RefusedError(AssertionError):
    """An FMU that cannot be instantiated; the message is what it has logged."""


class Instance:
    """An instance of an unpacked FMU, in either version.

    Args:
        folder: The unpacked FMU.
        table: Its table.
        version: 2 or 3.
        location: Resource location; None: that of the folder.
        token: GUID or instantiationToken; None: the table's.
    """

    def __init__(
        self,
        folder: Path,
        table: Table,
        version: int = 2,
        location: str | None = None,
        token: str | None = None,
        model: str = "Model",
    ) -> None:
        platform = PLATFORMS[this_platform()]
        place = platform.fmi2 if version == 2 else platform.fmi3
        self.dll = ctypes.CDLL(str(folder / "binaries" / place / f"{model}{platform.suffix}"))
        self.table, self.version = table, version
        self.log: list[tuple[int, str, str]] = []
        self.c = c_void_p(self._instantiate(folder, location, (token or table.token).encode()))
        if not self.c:
            raise RefusedError(self.messages())

    def _instantiate(self, folder: Path, location: str | None, token: bytes) -> int | None:
        if self.version == 2:
            self._logger: Any = _LOG2(self._log2)
            self._callbacks = _Callbacks(self._logger)
            create: Any = self.dll.fmi2Instantiate
            uri = (location or resources_uri(folder)).encode()
            arguments: tuple[Any, ...] = (b"it", 1, token, uri, byref(self._callbacks), 0, 1)
        else:
            self._logger = _LOG3(self._log3)
            create = self.dll.fmi3InstantiateCoSimulation
            path = (location or f"{folder}/resources/").encode()
            no, none = c_bool(False), c_size_t(0)
            arguments = (b"it", token, path, no, no, no, no, None, none, None, self._logger, None)
        create.restype = c_void_p
        found: int | None = create(*arguments)
        return found

    def _log2(self, _env: Any, _name: bytes, status: int, category: bytes, text: bytes) -> None:
        self.log.append((status, category.decode(), text.decode().replace("%%", "%")))

    def _log3(self, _env: Any, status: int, category: bytes, text: bytes) -> None:
        self.log.append((status, category.decode(), text.decode()))

    def messages(self) -> str:
        """All that has been logged."""
        return "\n".join(text for _, _, text in self.log)

    def __call__(self, name: str, *arguments: Any) -> int:
        """Call a function of the standard without its prefix; returns the status."""
        status: int = self.dll[f"fmi{self.version}{name}"](self.c, *arguments)
        return status

    def start(self, start_time: float = 0.0) -> Instance:
        """Go through initialization."""
        assert self.enter(start_time) == OK, self.messages()
        assert self("ExitInitializationMode") == OK, self.messages()
        return self

    def enter(self, start_time: float = 0.0) -> int:
        """Enter initialization mode; returns the status."""
        times = (c_int(0), c_double(0), c_double(start_time), c_int(0), c_double(0))
        if self.version == 3:
            return self("EnterInitializationMode", *times)
        return max(self("SetupExperiment", *times), self("EnterInitializationMode"))

    def step(self, time: float, size: float = STEP) -> int:
        """Take a communication step; returns the status."""
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

    def _call(
        self, verb: str, kind: str, references: Sequence[int], values: Any, count: int
    ) -> int:
        array = (c_uint * len(references))(*references)
        sizes = (c_size_t(len(references)),)
        if self.version == 2:
            return self(f"{verb}{kind}", array, *sizes, values)
        return self(f"{verb}{kind}", array, *sizes, values, c_size_t(count))

    def set(self, name: str, *values: float) -> int:
        """Set all elements of a variable; returns the status."""
        return self.set_references(self._references(name), values, self.table.row(name).kind)

    def set_references(
        self, references: Sequence[int], values: Sequence[Any], kind: str = "Real"
    ) -> int:
        """Set by value references; returns the status."""
        name, c_type = self._function(kind)
        cast = int if kind == "Enumeration" else bytes if kind == "String" else c_type
        return self._call(
            "Set", name, references, (c_type * len(values))(*map(cast, values)), len(values)
        )

    def get(self, name: str) -> list[Any]:
        """Values of all elements of a variable."""
        row = self.table.row(name)
        status, values = self.get_references(self._references(name), prod(row.shape), row.kind)
        assert status == OK, self.messages()
        return values

    def get_references(
        self, references: Sequence[int], count: int, kind: str = "Real"
    ) -> tuple[int, list[Any]]:
        """Status and values by value references."""
        name, c_type = self._function(kind)
        values = (c_type * count)()
        status = self._call("Get", name, references, values, count)
        return status, list(values)

    def _references(self, name: str) -> list[int]:
        return self.table.elements(name) if self.version == 2 else [self.table.references[name]]

    def _function(self, kind: str) -> tuple[str, Any]:
        if self.version == 3:
            return _FUNCTIONS3[kind]
        return _FUNCTIONS2[kind]

    # States.

    def save(self) -> c_void_p:
        """Get a state."""
        state = c_void_p()
        assert self(_state("Get", self.version), byref(state)) == OK, self.messages()
        return state

    def load(self, state: c_void_p) -> int:
        """Set a state; returns the status."""
        return self(_state("Set", self.version), state)

    def drop(self, state: c_void_p) -> int:
        """Free a state; returns the status."""
        return self(_state("Free", self.version), byref(state))

    def serialize(self, state: c_void_p) -> bytes:
        """A state as bytes."""
        size = c_size_t()
        word = "state" if self.version == 2 else "State"
        assert self(f"SerializedFMU{word}Size", state, byref(size)) == OK, self.messages()
        content = (ctypes.c_ubyte * size.value)()
        assert self(f"SerializeFMU{word}", state, content, size) == OK, self.messages()
        return bytes(content)

    def deserialize(self, content: bytes) -> tuple[int, c_void_p]:
        """Status, and a state from bytes."""
        state = c_void_p()
        name = "DeSerializeFMUstate" if self.version == 2 else "DeserializeFMUState"
        buffer = (ctypes.c_ubyte * len(content)).from_buffer_copy(content) if content else None
        return self(name, buffer, c_size_t(len(content)), byref(state)), state

    def free(self) -> None:
        """Free the instance."""
        self.dll[f"fmi{self.version}FreeInstance"](self.c)


def _state(verb: str, version: int) -> str:
    return f"{verb}FMUstate" if version == 2 else f"{verb}FMUState"


def comma_locale(folder: Path) -> str:
    """Make a locale with a decimal comma, which this process can then set for LC_NUMERIC."""
    (folder / "comma.src").write_text(COMMA)
    made = ["localedef", "-c", "--no-archive", "-i", "comma.src", "-f", "ANSI_X3.4-1968", "./comma"]
    subprocess.run(
        made, cwd=folder, check=False, capture_output=True, timeout=300
    )  # it warns, with status 1
    os.environ["LOCPATH"] = str(folder)
    return "comma"
