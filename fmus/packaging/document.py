"""The parts of an FMU for human readers: documentation, licences and its picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Final

from ..interface.variables import Interface, Numbers, Variable
from .description import Identity
from .libraries import licence, own_licences
from .python_runtime import MIN_PYTHON, NEEDS, PATHS_VARIABLE
from .templating import render

PICTURES: Final = {
    "PandaPlant": "plant.png",
    "PandaController": "controller.png",
    "PandaTrajectory": "trajectory.png",
}
_FEW: Final = 12  # most values shown in a table's cell


@dataclass(frozen=True)
class About:
    """Content of the documentation besides the interface.

    Attributes:
        law: Description of what the FMU computes.
        needs: Run-time requirements, one paragraph each.
        licences: Packages whose files or code it contains, and names of their licence files.
        third_party: Third-party software that it contains or uses.
    """

    law: str
    needs: tuple[str, ...]
    licences: tuple[tuple[str, str], ...] = ()
    third_party: str = ""


def documents(interface: Interface, identity: Identity, fmi: int, about: About) -> dict[str, bytes]:
    """Return the members of an FMU that are for human readers, by path.

    Raises:
        CosimError: A licence's text is missing.
    """
    folder = "documentation/licenses"
    members = {
        "documentation/index.html": documentation(interface, identity, fmi, about),
        "documentation/externalDependencies.txt": "\n".join((*about.needs, "")).encode(),
        **{f"{folder}/{name}": text for name, text in own_licences().items()},
        f"{folder}/third_party.txt": about.third_party.encode(),
    }
    for package, name in about.licences:
        members[f"{folder}/{package}-{Path(name).stem}.txt"] = licence(package, name)
    picture = PICTURES.get(interface.model)
    if picture:
        place = "model.png" if fmi == 2 else "terminalsAndIcons/icon.png"
        members[place] = Path(__file__).with_name(picture).read_bytes()
    return members


def documentation(interface: Interface, identity: Identity, fmi: int, about: About) -> bytes:
    """Make documentation/index.html."""
    return render(
        "documentation.html.j2",
        {"listed": listed, "shaped_name": shaped_name, "units": units, "range": value_range},
        interface=interface,
        token=identity.token,
        step_size=f"{identity.step_size:g}",
        fmi=fmi,
        law=cleandoc(about.law),
        needs=about.needs,
        coupled=interface.model in PICTURES,
    )


def python_needs(packages: Sequence[str]) -> tuple[str, ...]:
    """Requirements of an FMU in Python.

    Args:
        packages: Names of packages that it imports.
    """
    python = ".".join(map(str, MIN_PYTHON))
    lowest = {name: ".".join(map(str, NEEDS[name])) for name in packages if name in NEEDS}
    wanted = [f"{name} {lowest[name]}" if name in lowest else name for name in packages]
    return (
        f"The FMU runs Python inside the importer's process: Python {python} or newer"
        + (f", with {', '.join(wanted)} or newer." if wanted else "."),
        "In a Python importer, its own packages are used. In any other, the Python that built the "
        "FMU is started; resources/variables.txt records its path.",
        f"Other packages are found through the environment variable {PATHS_VARIABLE}: the folder "
        "that holds them, for the same Python version.",
    )


PYTHON_THIRD_PARTY: Final = """\
Used at run time, not contained in the FMU:
  Python (Python Software Foundation License) and the packages that it needs.
"""


def shaped_name(variable: Variable) -> str:
    """Name with the ranges of its indices, such as `jac[1..6,1..7]`."""
    return variable.name + (
        f"[{','.join(f'1..{n}' for n in variable.shape)}]" * bool(variable.shape)
    )


def units(variable: Variable) -> str:
    """Units of a variable, each once; its type if it has no unit."""
    found = dict.fromkeys(s.unit for s in variable.scalars(0) if s.unit)
    return ", ".join(found) or variable.kind


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
