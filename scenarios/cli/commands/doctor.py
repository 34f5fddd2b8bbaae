"""`panda-cosim doctor`."""

from __future__ import annotations

import platform
import re
import shutil
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import requires, version
from pathlib import Path
from typing import Annotated, Literal

import typer

from ....fmus.atomic import cache_folder
from ....fmus.build.compile import BACKENDS, can_compile, this_platform
from ....fmus.build.libraries import is_prebuilt
from ....fmus.errors import CosimError
from ....fmus.reading import is_noexec
from ..console import as_cell, show, show_json, table, tell

State = Literal["ok", "optional", "needed"]

# Not `options.Json`: this command must start without numpy, which `options` imports.
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
STATES = {
    "ok": "[green]ok[/green]",
    "optional": "[yellow]--[/yellow]",
    "needed": "[bold red]MISSING[/bold red]",
}
OPTIONAL = {  # packages that not all commands need
    **dict.fromkeys(("imageio-ffmpeg", "matplotlib", "mediapy", "pillow"), "pictures"),
    **dict.fromkeys(("control", "scipy"), "analyze"),
}


@dataclass(frozen=True)
class Finding:
    """The state of one prerequisite."""

    what: str
    state: State  # "ok", or missing and "optional" or "needed" to run scenarios
    detail: str
    remedy: str = ""  # how to get it


def command(json: Json = False) -> None:
    """Show what is installed, what is missing, and how to get it.

    Exit code 0: scenarios can be run and recorded, even if something for pictures or other tools is
    missing. Exit code 1: they cannot.

    ```
    panda-cosim doctor
    ```
    """
    tell("Examining this machine ...")
    findings = examine()
    missing = [finding.what for finding in findings if finding.state == "needed"]
    optional = [finding.what for finding in findings if finding.state == "optional"]
    if json:
        show_json({"ready": not missing, "findings": findings})
    else:
        rows = table(("", "what*", "found*"))
        for finding in findings:
            remedy = f"\n[bold]{as_cell(finding.remedy)}[/bold]" if finding.remedy else ""
            rows.add_row(STATES[finding.state], finding.what, as_cell(finding.detail) + remedy)
        show(rows)
    if missing:
        raise CosimError(f"scenarios cannot be run here: {', '.join(missing)}")
    if not json:
        rest = f" Not found: {', '.join(optional)}." if optional else ""
        show(f"Scenarios can be run and recorded.{rest}", "bold green")


def examine() -> list[Finding]:
    """Examine all prerequisites; a missing one raises no error."""
    python = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    checks = (_checked(*check) for check in CHECKS)
    return list(dict.fromkeys((Finding("Python", "ok", python), *_packages(), *checks)))


def _checked(what: str, state: State, check: Callable[[], str], remedy: str = "") -> Finding:
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


def _packages() -> Iterator[Finding]:
    yield Finding("panda-cosim", "ok", version("panda-cosim"))
    for requirement in requires("panda-cosim") or ():
        package, _, marker = requirement.partition(";")
        system = re.search(r"sys_platform\s*==\s*[\"'](\w+)[\"']", marker)
        if "extra ==" not in marker and (system is None or system[1] == sys.platform):
            name = re.split(r"[^\w.-]", package.strip())[0]
            use = OPTIONAL.get(name)
            state: State = "optional" if use else "needed"
            yield _package(name, f"{name} (for {use})" if use else name, state, package.strip())


def _package(name: str, what: str, state: State, requirement: str) -> Finding:
    remedy = f"pip install '{requirement}'"
    try:
        installed = version(name)
    except ModuleNotFoundError:
        return Finding(what, state, "not installed", remedy)
    least = re.search(r">=\s*([\d.]+)", requirement)
    if least and _numbers(installed) < _numbers(least[1]):
        return Finding(what, state, f"{installed} is too old", remedy)
    return Finding(what, "ok", installed)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:3])


def _fmu_libraries() -> str:
    """Part of the package, or compiled when FMUs are built."""
    here = this_platform()
    missing = [backend for backend in BACKENDS if not is_prebuilt(backend, here)]
    if missing and not can_compile(here):
        raise CosimError(
            f"no library of {', '.join(missing)}, and no compiler; pip install "
            "'panda-cosim[cross]', or a compiler named cc, gcc or clang"
        )
    return f"{here}, compiled {'when they are needed' if missing else 'with the package'}"


def _cache() -> str:
    folder = cache_folder()
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CosimError(f"{folder}: cannot be written to: {error.strerror}") from error
    if is_noexec(folder):
        raise CosimError(f"{folder}: mounted noexec, so that no library can be loaded from it")
    from ....fmus.sources.targets import outdated  # noqa: PLC0415 - numpy may be missing

    return f"{folder}: {'the next run builds the FMUs' if outdated() else 'the FMUs are built'}"


def _opengl() -> str:
    from ...pictures.offscreen import describe_gl  # noqa: PLC0415 - numpy may be missing

    backend, detail = describe_gl()
    if backend is None:
        raise CosimError(detail)
    return f"{backend}: {detail}"


def _ffmpeg() -> str:
    from ...pictures.video import find_ffmpeg  # noqa: PLC0415 - numpy may be missing

    return find_ffmpeg()


def _menagerie() -> str:
    from ...pictures.meshes import find_menagerie  # noqa: PLC0415 - numpy may be missing

    folder = find_menagerie()
    if folder is None:
        raise CosimError("not found, so that the arm is drawn in plain shapes")
    return str(folder)


def _shared_library() -> str:
    """The library that hosts other than Python load for FMUs of the Python kind."""
    folder, name = (sysconfig.get_config_var(key) for key in ("LIBDIR", "INSTSONAME"))
    path = Path(sys.base_prefix if sys.platform == "win32" else folder or "/", name or "")
    if sys.platform != "win32" and not (
        sysconfig.get_config_var("Py_ENABLE_SHARED") and path.exists()
    ):
        raise CosimError("this Python has none")
    return str(path)


def _compiler() -> str:
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        raise CosimError("not found")
    return compiler


# What, whether scenarios can be run without, the check, and the remedy if the error names none.
CHECKS: tuple[tuple[str, State, Callable[[], str], str], ...] = (
    ("libraries of the FMUs", "needed", _fmu_libraries, ""),
    ("FMU cache", "needed", _cache, "set PANDA_COSIM_CACHE to a folder that is yours alone"),
    ("OpenGL (for pictures)", "optional", _opengl, ""),
    ("ffmpeg (for the video)", "optional", _ffmpeg, ""),
    ("Menagerie's meshes (for looks)", "optional", _menagerie,
     "set MENAGERIE_ROOT to a checkout of MuJoCo Menagerie"),
    ("Python as shared library (for FMUs in Python in other hosts)", "optional", _shared_library,
     "use a Python with a shared library: Debian's python3 with libpython3-dev, or "
     "PYTHON_CONFIGURE_OPTS=--enable-shared pyenv install 3.12"),
    ("C compiler (for the tests)", "optional", _compiler,
     "on Debian or Ubuntu, apt-get install gcc"),
)  # fmt: skip
