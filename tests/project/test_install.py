"""The package as others install it: what a build needs, and a wheel without its source."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from importlib.util import cache_from_source
from pathlib import Path

import pytest

from bounded import ran
from fault_support import write_scenario
from fmu_support import copy_libraries
from panda_cosim.cli.commands import COMMANDS
from panda_cosim.fmus.build.libraries import BACKENDS

ROOT = Path(__file__).parents[2]
SOURCES = ("assets", "plant", "controller", "fmus", "scenarios", "src")
FILES = (".ci/build_backend.py", "pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "NOTICE")


def run(*command: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | environment
    return ran(list(map(str, command)), cwd=cwd, env=environment, code=None)


# --- What a build needs ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "compiler", "needed"),
    [
        ("wheel", True, {"fmpy", "mujoco"}),
        ("wheel", False, {"fmpy", "mujoco", "ziglang"}),
        ("editable", True, set()),  # compiles what it needs, once it is used
        ("editable", False, {"fmpy", "mujoco", "ziglang"}),
    ],
)
def test_a_build_needs_headers_and_compiler_where_it_compiles(kind, compiler, needed, tmp_path):
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "p"\nversion = "1"\n')
    if compiler:
        (tmp_path / "cc").touch(mode=0o755)
    ask = f"import build_backend as b; print(*b.get_requires_for_build_{kind}(), sep='#')"
    backend = str(ROOT / ".ci")
    done = run(sys.executable, "-c", ask, cwd=tmp_path, PATH=str(tmp_path), PYTHONPATH=backend)
    names = done.stdout.splitlines()[-1].split("#")
    assert {re.split(r"\W", name)[0] for name in names} - {""} == needed, done.stderr


def test_an_editable_install_compiles_modules_where_python_keeps_no_byte_code(tmp_path):
    source = copied_source(tmp_path)
    code = "import build_backend; build_backend.build_editable('.')"
    backend = str(source / ".ci")
    python = {"PYTHONPATH": backend, "PYTHONDONTWRITEBYTECODE": "1"}
    done = run(sys.executable, "-c", code, cwd=source, **python)
    assert done.returncode == 0, done.stderr
    modules = [path for folder in SOURCES for path in (source / folder).rglob("*.py")]
    assert len(modules) > 100
    assert [path for path in modules if not Path(cache_from_source(str(path))).is_file()] == []


# --- A wheel ---------------------------------------------------------------------------------


def copied_source(folder: Path) -> Path:
    source = folder / "source"
    source.mkdir()
    skipped = shutil.ignore_patterns("__pycache__", "*.egg-info", "node_modules")
    for name in SOURCES:
        shutil.copytree(ROOT / name, source / name, ignore=skipped, symlinks=True)
    for name in FILES:
        (source / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    return source


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Install a wheel into a fresh environment that has the other packages, and not the source."""
    folder = tmp_path_factory.mktemp("wheel")
    source = copied_source(folder)
    copy_libraries(source / "fmus" / "native" / "lib", "stepper")  # which the build compiles
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    options = ("--no-deps", "--no-build-isolation", "-w", folder)
    built = run(*pip, "wheel", source, *options, cwd=folder)
    assert built.returncode == 0, built.stderr
    shutil.rmtree(source)
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    (wheel,) = folder.glob("*.whl")
    done = run(*pip, "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    assert done.returncode == 0, done.stderr
    where = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder)
    outer = sysconfig.get_path("purelib")
    Path(where.stdout.strip(), "outer.pth").write_text(f"{outer}\n")  # its own .pth are not read
    found = run(python, "-P", "-c", "import panda_cosim; print(panda_cosim.__file__)", cwd=folder)
    assert found.stdout.startswith(str(folder)), found.stdout + found.stderr
    return folder


def test_a_wheel_is_tagged_for_the_platform_of_its_libraries(installed):
    (wheel,) = installed.glob("*.whl")
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.name.endswith(f"-py3-none-{platform}.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = [Path(n).name for n in archive.namelist() if "/native/lib/" in n]
        (tags,) = (n for n in archive.namelist() if n.endswith(".dist-info/WHEEL"))
        assert f"Tag: py3-none-{platform}\n" in archive.read(tags).decode()
    assert sorted(n.partition("-")[0] for n in names) == sorted(BACKENDS)


def test_a_wheel_has_the_data_beside_each_module():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    package, packed = ROOT / "src" / "panda_cosim", set[Path]()
    for name, globs in settings["tool"]["setuptools"]["package-data"].items():
        packed |= {p for glob in globs for p in (ROOT / "src" / name.replace(".", "/")).glob(glob)}
    data = {path for kind in ("css", "html", "toml") for path in package.rglob(f"*.{kind}")}
    assert not {path for path in data - packed if "source" not in path.parts}


# In an order in which each finds what it needs; of other commands, the help.
LINES = [
    "run ./short --out first --no-video --plot",
    "list",
    "new lift",
    "info",
    "check lift",
    "plot first",
    "export first all.csv",
    "inputs ./short commands.csv",
    "build --out fmus",
    "run --system fmus/Panda.ssp --out system",
    "regress --scenarios suite --update --yes",
    "regress --scenarios suite --report report",
    "doctor",
    "analyze",
    "view first --out view.html",
    "run ./short --out second --no-video",
    "compare first second",
    "sweep ./short --vary controller.kp=7:8:2 --out swept",
    "sweep report swept",
]


def run_commands(installed: Path, commands: list[str], cache: Path | None) -> None:
    """Run commands one after the other in an empty folder, each of which has to succeed."""
    work = installed / f"work{len(commands)}"
    write_scenario(work / "short", 0.05)
    write_scenario(work / "suite" / "short", 0.05)
    environment = {} if cache is None else {"PANDA_COSIM_CACHE": str(cache)}
    for line in commands:
        program = installed / "venv" / "bin" / "panda-cosim"
        done = run(program, *line.split(), cwd=work, **environment)
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
        assert "Traceback" not in done.stderr


def test_a_wheel_without_the_source_runs_a_scenario(installed):
    run_commands(installed, LINES[:3], cache=None)


@pytest.mark.long
def test_a_wheel_without_the_source_runs_every_command(installed):
    helps = [f"{name} --help" for name in COMMANDS]
    run_commands(installed, [*LINES, *helps], cache=installed / "cache")
