"""An FMU on a library of `fmus/native`: its description, its libraries, and the archive."""

from __future__ import annotations

import io
import struct
import uuid
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import IO, Any, Final
from urllib.parse import quote

from ...assets import STEP_SIZE
from ..interface.variables import Interface, Variable
from .description import NOTHING, STOP_TIME, Layout
from .description import members as description_of
from .identity import code_digest, digest, mujoco_package
from .libraries import NEED_MUJOCO, library, mujoco_library
from .platforms import PLATFORMS

Option = tuple[str, str]
FIXED_DATE: Final = (2026, 1, 1, 0, 0, 0)  # of all members of archives
_COMPRESSED: Final = (".fmu", ".png")  # compressed already


@dataclass(frozen=True)
class NativeFmu:
    """An FMU on a library of ours: all that is in the file, before there is one.

    The modules of `fmus/sources` make it: `own_fmu`, laws, slaves and models. It is of no FMI
    version and no platform; `build` takes these and makes the bytes of the file. Do not call it to
    run an FMU: `sources.targets` finds it in the cache by `digest`.
    """

    interface: Interface  # its variables; `Variable.source` in the backend's form
    backend: str  # key of `libraries.BACKENDS`
    law: str  # description of what it computes, for the documentation
    resources: Mapping[str, bytes] = field(default_factory=dict)  # contents by name
    options: tuple[Option, ...] = ()  # for the backend
    recorded: tuple[Option, ...] = ()  # options that depend on this machine
    needs: tuple[str, ...] = (NOTHING,)  # run-time requirements, one paragraph each
    step_size: float = STEP_SIZE  # internal step [s]
    stop_time: float = STOP_TIME  # of the default experiment [s]
    is_restorable: bool = True  # whether its state can be saved and restored
    # Describes it once more, under another MuJoCo; None: it has no part in it.
    again: Callable[[], NativeFmu] | None = field(default=None, compare=False)

    @property
    def model(self) -> str:
        """Model name and identifier."""
        return self.interface.model

    @property
    def holds(self) -> tuple[str, ...]:
        """Packages of which it holds a library."""
        return (mujoco_package(),) if self.backend in NEED_MUJOCO else ()

    @cached_property
    def digest(self) -> str:
        """Hash of everything that the FMU depends on, apart from this machine."""
        times = (self.step_size, self.stop_time)
        parts = (self.interface, self.backend, self.law, self.options, *times, self.is_restorable)
        return digest(code_digest(), repr(parts), self.resources)

    @property
    def token(self) -> str:
        """GUID of FMI 2.0, instantiation token of FMI 3.0; a hash of the content."""
        return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, self.digest)}}}"

    def build(self, layout: Layout, platforms: Sequence[str]) -> bytes:
        """Make the .fmu file: description, documentation, resources, and libraries."""
        members, options = description_of(self, layout), (*self.options, *self.recorded)
        written = table(self.interface, self.token, self.step_size, options, scalars=layout.scalars)
        for name, content in {"variables.txt": written, **self.resources}.items():
            members[f"resources/{name}"] = content
        for name in platforms:
            platform = PLATFORMS[name]
            folder = f"binaries/{platform.fmi2 if layout.fmi == 2 else platform.fmi3}"
            content = library(self.backend, name).read_bytes()
            members[f"{folder}/{self.model}{platform.suffix}"] = content
            if self.backend in NEED_MUJOCO:
                members[f"{folder}/{platform.mujoco}"] = mujoco_library(name)
        return archive(members)


def archive(members: Mapping[str, bytes]) -> bytes:
    """Return a zip file with its members in alphabetical order; equal contents, equal bytes."""
    packed = io.BytesIO()
    add_members(packed, members)
    return packed.getvalue()


def add_members(packed: IO[bytes], members: Mapping[str, bytes]) -> None:
    """Add members to a zip file, which may be empty, as `archive` does."""
    with zipfile.ZipFile(packed, "a") as file:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, FIXED_DATE)
            info.create_system = 3  # Unix, on every platform
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            method = zipfile.ZIP_STORED if name.endswith(_COMPRESSED) else zipfile.ZIP_DEFLATED
            file.writestr(info, members[name], method, compresslevel=9)


def table(
    interface: Interface, token: str, step_size: float, options: Iterable[Option], *,
    scalars: bool = False,
) -> bytes:  # fmt: skip
    """Make `resources/variables.txt`, which `fmus/README.md` describes."""
    lines = [["fmu", "2"], ["token", token], ["step", bits(step_size)]]
    lines += [["option", key, text(value)] for key, value in options]
    reference = 0
    for variable in interface.variables:
        sizes = [1] * variable.size if scalars else [array.size for array in variable.arrays()]
        arrays = " ".join(map(str, sizes)) if len(sizes) > 1 else "-"
        lines.append(["variable", str(reference), *_fields(variable), arrays])
        reference += variable.size
    time = [str(reference), "-", "independent", "continuous", "Real", interface.time_name]
    lines.append(["variable", *time, *["-"] * 5])
    return "".join("\t".join(fields) + "\n" for fields in lines).encode()


def _fields(variable: Variable) -> list[str]:
    start, bounds = variable.start, (variable.minimum, variable.maximum)
    if variable.kind == "Enumeration":  # the numbers of its items
        start, bounds = variable.number_of(str(start)), (1.0, len(variable.choices))
    return [
        "x".join(map(str, variable.shape)) or "-",
        variable.causality,
        variable.variability,
        variable.kind,
        text(variable.name),
        text(str(start or "")) if variable.kind == "String" else _numbers(start),
        *map(_numbers, bounds),
        text(variable.source) or "-",
    ]


def _numbers(values: Any) -> str:
    if values is None:
        return "-"
    return " ".join(map(bits, values if isinstance(values, tuple) else (values,)))


def bits(number: float) -> str:
    """The bits of a number, independent of locale and rounding."""
    return struct.pack(">d", number).hex()


def text(written: str) -> str:
    """Text with the field separators escaped."""
    return quote(written, safe="".join(map(chr, (*range(32, 37), *range(38, 127)))))
