"""The parts of an FMU for human readers: documentation, licences and its picture."""

from __future__ import annotations

import math
from importlib.metadata import distribution, version
from inspect import cleandoc
from pathlib import Path
from typing import Final

from ..interface.variables import Interface, Numbers, Variable
from .description import Identity, render
from .libraries import MUJOCO, NEED_MUJOCO, licence, own_licences

PICTURES: Final = {
    "PandaPlant": "plant.png",
    "PandaController": "controller.png",
    "PandaTrajectory": "trajectory.png",
}
NOTHING: Final = "Nothing: neither Python nor any library that it does not contain."
_FEW: Final = 12  # most values shown in a table's cell
_HEADERS: Final = "FMI headers (BSD-2-Clause, Modelica Association), compiled into the binaries.\n"


def documents(  # noqa: PLR0913 - the FMU, its identity and its version
    interface: Interface, identity: Identity, fmi: int, law: str, needs: tuple[str, ...],
    backend: str,
) -> dict[str, bytes]:  # fmt: skip
    """Return the members of an FMU that are for human readers, by path."""
    opens_mujoco = backend in NEED_MUJOCO
    glibc = "2.27" if opens_mujoco else "2.17"
    systems = f"Linux: glibc {glibc} or newer. Windows: 10 or newer. macOS: 11 or newer."
    folder = "documentation/licenses"
    members = {
        "documentation/index.html": documentation(interface, identity, fmi, law, (*needs, systems)),
        "documentation/externalDependencies.txt": "\n".join((*needs, systems, "")).encode(),
        **{f"{folder}/{name}": text for name, text in own_licences().items()},
        f"{folder}/third_party.txt": _third_party(backend).encode(),
    }
    for file in distribution(MUJOCO).files or [] if opens_mujoco else []:
        if "dist-info/licenses" in str(file):
            members[f"{folder}/{MUJOCO}-{file.stem}.txt"] = licence(MUJOCO, file.name)
    picture = PICTURES.get(interface.model)
    if picture:
        place = "model.png" if fmi == 2 else "terminalsAndIcons/icon.png"
        members[place] = Path(__file__).with_name(picture).read_bytes()
    return members


def documentation(
    interface: Interface, identity: Identity, fmi: int, law: str, needs: tuple[str, ...]
) -> bytes:
    """Make documentation/index.html."""
    return render(
        "documentation.html.j2",
        {"listed": listed, "shaped_name": shaped_name, "units": units, "range": value_range},
        interface=interface,
        token=identity.token,
        step_size=f"{identity.step_size:g}",
        fmi=fmi,
        law=cleandoc(law),
        needs=needs,
        coupled=interface.model in PICTURES,
    )


def _third_party(backend: str) -> str:
    """Third-party software that an FMU contains or uses."""
    if backend == "python":
        return (
            f"In this FMU: {_HEADERS}Used at run time, not contained in the FMU:\n"
            "  Python (Python Software Foundation License) and the packages that it needs.\n"
        )
    if backend not in NEED_MUJOCO:
        return f"In this FMU: {_HEADERS}"
    engine = f"MuJoCo {version(MUJOCO)} (Apache-2.0, DeepMind Technologies), beside them.\n"
    return f"In this FMU:\n  {_HEADERS}  {engine}"


def shaped_name(variable: Variable) -> str:
    """Name with the ranges of its indices, such as `jac[1..6,1..7]`."""
    indices = ",".join(f"1..{n}" for n in variable.shape)
    return f"{variable.name}[{indices}]" if indices else variable.name


def units(variable: Variable) -> str:
    """Units of a variable, each once; its type if it has no unit."""
    return ", ".join(dict.fromkeys(s.unit for s in variable.scalars(0) if s.unit)) or variable.kind


def listed(value: object) -> str:
    """Format a value, or several; shortens long lists."""
    if value is None:
        return ""
    values = value if isinstance(value, tuple) else (value,)
    shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in values[:_FEW]]
    return ", ".join(shown) + ", ..." * (len(values) > _FEW)


def value_range(variable: Variable) -> str:
    """Range of valid values, or "" if all are valid."""
    if variable.choices:
        return ", ".join(f"{i}: {name}" for i, name in enumerate(variable.choices, 1))
    low, high = _finite(variable.minimum), _finite(variable.maximum)
    return f"{listed(low)} to {listed(high)}" if low is not None or high is not None else ""


def _finite(bound: Numbers | None) -> Numbers | None:
    values = bound if isinstance(bound, tuple) else () if bound is None else (bound,)
    return bound if any(map(math.isfinite, values)) else None
