"""`panda-cosim doctor`."""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.metadata import requires, version
from typing import Literal, NamedTuple

from rich.text import Text

from ...fmus.atomic import cache_folder
from ...fmus.build.engines import sparse_fault
from ...fmus.build.identity import mujoco_version
from ...fmus.build.libraries import BACKENDS, compiler, is_prebuilt
from ...fmus.build.platforms import this_platform
from ...fmus.errors import CosimError
from ...fmus.extras import last_python, no_release
from ...fmus.twins import LONGER, changed, notice
from ..console import Item, show_result, table, tell
from ..forms import flag

State = Literal["ok", "optional", "needed"]

STATES = {
    "ok": Text("ok", "green"),
    "optional": Text("--", "yellow"),
    "needed": Text("MISSING", "bold red"),
}
OPTIONAL = {  # packages that not all commands need
    **dict.fromkeys(("imageio-ffmpeg", "matplotlib", "mediapy", "pillow"), "pictures"),
    **dict.fromkeys(("control", "scipy"), "analyze"),
}

EXTRAS = {"ompl": "route", "toppra": "retime"}  # packages that lag behind Python


class Finding(NamedTuple):
    """The state of one prerequisite."""

    what: str
    state: State  # "ok", or missing and "optional" or "needed" to run scenarios
    detail: str
    remedy: str = ""  # how to get it


def command(json: bool = flag("--json")) -> None:
    """Show what is installed, what is missing, and how to get it.

    Exit code 0: scenarios can be run and recorded, even if something for pictures or other tools is
    missing. Exit code 1: they cannot.

    ```
    panda-cosim doctor
    ```

    Args:
        json: Print the result as JSON instead of tables.
    """
    # Its option is not that of `options`, whose import needs numpy, which may be missing.
    tell("Examining this machine ...")
    findings = examine()
    missing = [each.what for each in findings if each.state == "needed"]
    optional = [each.what for each in findings if each.state == "optional"]
    content = {"ready": not missing, "findings": [finding._asdict() for finding in findings]}
    items: list[Item] = [table(("", "what*", "found*"), map(_row, findings))]
    if not missing:
        rest = f" Not found: {', '.join(optional)}." if optional else ""
        items.append(Text(f"Scenarios can be run and recorded.{rest}", "bold green"))
    show_result(content, items, json=json)
    if missing:
        raise CosimError(f"scenarios cannot be run here: {', '.join(missing)}")


def _row(finding: Finding) -> tuple[Text, str, Text]:
    remedy = f"\n{finding.remedy}" if finding.remedy else ""
    return STATES[finding.state], finding.what, Text.assemble(finding.detail, (remedy, "bold"))


def examine() -> list[Finding]:
    """Examine all prerequisites; a missing one raises no error."""
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    python = Finding("Python", "ok", found)
    checks = (_checked(*check) for check in CHECKS)
    return list(dict.fromkeys((python, *_packages(), *_lagging(), *checks)))


def _packages() -> Iterator[Finding]:
    """Find the package itself, and what it requires without extras."""
    required = (each for each in requires("panda-cosim") or () if "extra ==" not in each)
    for requirement in ("panda-cosim", *required):
        name = re.split(r"[^\w.-]", requirement)[0]
        use = OPTIONAL.get(name)
        what = f"{name} (for {use})" if use else name
        try:
            yield Finding(what, "ok", version(name))
        except ModuleNotFoundError:
            state: State = "optional" if use else "needed"
            yield Finding(what, state, "not installed", f"pip install '{requirement}'")


def _lagging() -> Iterator[Finding]:
    """Find packages of extras that have no release for this Python."""
    for name, extra in EXTRAS.items():
        if no_release(name):
            what, remedy = f"{name} (for {extra})", f"Python 3.{last_python(name)}"
            yield Finding(what, "optional", "has no release for this Python", remedy)


def _checked(what: str, state: State, check: Callable[[], str], remedy: str) -> Finding:
    """Return what a check says, or, of its error, the fault and the remedy."""
    try:
        return Finding(what, "ok", check())
    except ModuleNotFoundError as error:
        name = error.name or str(error)
        state = "optional" if name in OPTIONAL else "needed"
        return Finding(name, state, "cannot be imported", f"pip install {name}")
    except CosimError as error:
        fault, *rest = re.split(r"; " if remedy else r"[:;] ", str(error), maxsplit=1)
        return Finding(what, state, fault, remedy or "".join(rest))


def _fmu_libraries() -> str:
    """Part of the package, or compiled when FMUs are built."""
    here = this_platform()
    missing = [backend for backend in BACKENDS if not is_prebuilt(backend, here)]
    if missing and not compiler(here):
        raise CosimError(
            f"no library of {', '.join(missing)}, and no compiler; pip install "
            "'panda-cosim[cross]', or a compiler named cc, gcc or clang"
        )
    return f"{here}, compiled {'when they are needed' if missing else 'with the package'}"


def _engine() -> str:
    """The version of MuJoCo in FMUs, and what is wrong with it."""
    return "; ".join((mujoco_version(), *sparse_fault()))


def _stepper() -> str:
    from ...fmus.master.kernel import load_stepper  # noqa: PLC0415 - numpy may be missing

    is_outdated = changed("kernel")
    if load_stepper() is None and not is_outdated:
        raise CosimError("its library cannot be loaded, so steps are taken in Python")
    return "in Python" if is_outdated else "in C"


def _twins() -> str:
    """What is in C as well as in Python."""
    equal = f"{', '.join(LONGER)}: run, as they are proven equal to the Python code"
    return f"{notice(LONGER) or equal}; the sensors have none"


def _cache() -> str:
    folder = cache_folder()
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CosimError(f"{folder}: cannot be written to: {error.strerror}") from error
    if sys.platform == "linux" and os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise CosimError(f"{folder}: mounted noexec, so that no library can be loaded from it")
    from ...fmus.sources.targets import outdated  # noqa: PLC0415 - numpy may be missing

    return f"{folder}: {'the next run builds the FMUs' if outdated() else 'the FMUs are built'}"


def _opengl() -> str:
    from ...result.pictures.offscreen import describe_gl  # noqa: PLC0415 - numpy may be missing

    return describe_gl()


def _ffmpeg() -> str:
    from ...result.pictures.video import find_ffmpeg  # noqa: PLC0415 - numpy may be missing

    return find_ffmpeg()


# What, whether scenarios can be run without, the check, and the remedy if the error names none.
CHECKS: tuple[tuple[str, State, Callable[[], str], str], ...] = (
    ("MuJoCo of the FMUs", "needed", _engine, ""),
    ("libraries of the FMUs", "needed", _fmu_libraries, ""),
    ("twins in C", "optional", _twins, ""),
    ("the master's step", "optional", _stepper, "install the package again"),
    ("FMU cache", "needed", _cache, "set PANDA_COSIM_CACHE to a folder that is yours alone"),
    ("OpenGL (for pictures)", "optional", _opengl, ""),
    ("ffmpeg (for the video)", "optional", _ffmpeg, ""),
)  # fmt: skip
