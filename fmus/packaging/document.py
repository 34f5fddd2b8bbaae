"""The documentation that an FMU carries, made from its table."""

from __future__ import annotations

from html import escape
from importlib.metadata import PackageNotFoundError, distribution
from inspect import cleandoc
from pathlib import Path
from typing import Final

from ..errors import CosimError
from ..interface.variables import Interface, Variable
from ..slaves.hosting import MIN_PYTHON, NEEDS, PATHS_VARIABLE

PICTURES: Final = {
    "PandaPlant": "plant.png",
    "PandaController": "controller.png",
    "PandaTrajectory": "trajectory.png",
}
_STYLE: Final = (
    "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse}td,th{border:1px solid #bbb;padding:.2em .5em;text-align:left}"
    "pre{background:#f4f4f4;padding:1em;overflow:auto}"
)
_COUPLING: Final = """\
<p>PandaPlant and PandaController are coupled by connecting variables of equal names:
<code>hand_xpos hand_xquat jac qpos[1..7] qvel[1..7] qfrc_bias</code> from the plant to the
controller, <code>ctrl</code> from the controller to the plant. The commands <code>pos_cmd quat_cmd
vel_cmd omega_cmd grip_cmd</code> come from PandaTrajectory or from your tool.</p>
<p>Communication step 0.001 s, or a whole multiple of it. Best is Gauss-Seidel: at t_k the
controller is set with what the plant and the trajectory give for t_k and stepped, then the plant
is set with the controller's <code>ctrl</code> and stepped: no delay. In Jacobi coupling
<code>ctrl</code> acts one step later. No output depends directly on an input of the same
instant, so there is no algebraic loop.</p>
"""
_BEHAVIOUR: Final = """\
<ul>
<li>Steps that are no whole multiple of 0.001 s are refused (fmi2Discard), with a message.</li>
<li>Inputs that are not finite are refused by name; those out of range are clamped, with a
warning. Fixed parameters cannot be set after initialization.</li>
<li>After a failure inside, its cause and traceback are logged and all further steps are
refused until fmi2Reset, or until a sound state is restored.</li>
<li>Messages are logged if logging is on, and go to standard error unless the environment
variable <code>PANDA_COSIM_STDERR</code> is 0.</li>
<li>fmi2GetFMUstate, fmi2SetFMUstate and serialization keep everything, parameters too: a replay
gives the same bits. A state fits the FMU of the same content only.</li>
</ul>
"""


def documentation(interface: Interface, guid: str, law: str, needs: tuple[str, ...]) -> bytes:
    """Make documentation/index.html.

    Args:
        interface: The FMU's table.
        guid: The FMU's GUID.
        law: What it computes; the docstring of the object inside.
        needs: Packages that it needs, keys of `NEEDS`.
    """
    parts = [
        f"<h1>{interface.model}</h1><p>{escape(interface.description)}.</p>",
        f"<p>GUID {guid}. FMI 2.0 for co-simulation.</p>",
        f"<h2>What it computes</h2><pre>{escape(cleandoc(law))}</pre>",
        "<h2>How to couple it</h2>" + _COUPLING,
        "<h2>How it behaves</h2>" + _BEHAVIOUR,
        "<h2>What it needs</h2>" + "".join(f"<p>{escape(line)}</p>" for line in _needs(needs)),
    ]
    for cause in ("input", "output", "parameter"):
        rows = [_row(v) for v in interface.variables if v.causality == cause]
        if rows:
            head = "<tr><th>name<th>unit<th>start<th>range<th>description</tr>"
            parts.append(f"<h2>{cause.capitalize()}s</h2><table>{head}{''.join(rows)}</table>")
    body = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{interface.model}</title><style>{_STYLE}</style></head>\n"
        f"<body>\n{body}\n</body></html>\n"
    ).encode()


def _row(variable: Variable) -> str:
    cells = (
        shaped_name(variable),
        ", ".join(dict.fromkeys(s.unit for s in variable.scalars(0))) or variable.kind,
        _numbers(variable.start),
        _range(variable),
        variable.description + (" (tunable)" if variable.variability == "tunable" else ""),
    )
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>\n"


def shaped_name(variable: Variable) -> str:
    """Name with its indices' ranges, as `jac[1..6,1..7]`."""
    return variable.name + (
        f"[{','.join(f'1..{n}' for n in variable.shape)}]" * bool(variable.shape)
    )


def _numbers(value: object) -> str:
    if value is None:
        return ""
    values = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values)


def _range(variable: Variable) -> str:
    if variable.minimum is None and variable.maximum is None:
        return ""
    return f"{_numbers(variable.minimum)} to {_numbers(variable.maximum)}"


def _needs(needs: tuple[str, ...]) -> list[str]:
    """What has to be installed, a paragraph each."""
    python = ".".join(map(str, MIN_PYTHON))
    packages = ", ".join(f"{name} {'.'.join(map(str, NEEDS[name]))}" for name in needs)
    return [
        f"The FMU runs Python inside the importer's process: Python {python} or newer with "
        f"{packages}, or newer.",
        "In a Python importer, its own packages are used. In any other, those of the Python that "
        "built the FMU, whose folders are recorded in resources/python_packages.txt and whose "
        "shared library the Linux binary names.",
        f"Other packages are found through the environment variable {PATHS_VARIABLE}: the folder "
        "that holds them, for the same Python version.",
        "Binaries are for Linux (glibc 2.32 or newer) and Windows, x86-64.",
    ]


def documents(
    interface: Interface, guid: str, law: str, needs: tuple[str, ...]
) -> dict[str, bytes]:
    """Return all members of an FMU that are for people, by path; arguments as above.

    Raises:
        CosimError: A licence's text is missing.
    """
    folder = "documentation/licenses"
    return {
        "documentation/index.html": documentation(interface, guid, law, needs),
        "documentation/externalDependencies.txt": "\n".join((*_needs(needs), "")).encode(),
        f"{folder}/license.txt": _licence("panda-cosim", "LICENSE"),
        f"{folder}/NOTICE.txt": _licence("panda-cosim", "NOTICE"),
        f"{folder}/PythonFMU.txt": _licence("pythonfmu", "LICENSE"),
        f"{folder}/third_party.txt": _THIRD_PARTY.encode(),
        "model.png": (Path(__file__).parent / PICTURES[interface.model]).read_bytes(),
    }


_THIRD_PARTY: Final = """\
In this FMU:
  PythonFMU (MIT licence, see PythonFMU.txt): the binaries, and pythonfmu/ below resources/.
Used by it where it runs, not in it:
  Python (Python Software Foundation License), NumPy (BSD-3-Clause), MuJoCo (Apache-2.0).
"""


def _licence(package: str, name: str) -> bytes:
    """Text of a licence file that a package was installed with."""
    beside = Path(__file__).parents[2] / name
    if package == "panda-cosim" and beside.is_file():  # in a checkout
        return beside.read_bytes()
    try:
        files = distribution(package).files or []
    except PackageNotFoundError:
        files = []
    for file in files:
        if file.name == name and "dist-info" in str(file):
            return Path(str(file.locate())).read_bytes()
    raise CosimError(f"{package}: its {name} is missing; install the package again")
