"""The layers: imports go one way, a foreign library has one place, and nothing heavy is early."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LAYERS = {
    "assets": set[str](),
    "plant": {"assets"},
    "controller": {"assets"},
    "fmus": {"assets", "plant", "controller"},
    "scenarios": {"assets", "plant", "controller", "fmus"},
}
# The same within two of them; their modules on top import none of these folders.
WITHIN = {
    "fmus": {
        "interface": set[str](),
        "slaves": {"interface"},
        "packaging": {"interface", "slaves"},
        "master": {"interface", "slaves", "packaging"},
    },
    "scenarios": {
        "definition": set[str](),
        "pictures": set[str](),
        "recording": {"definition"},
        "running": {"definition", "pictures", "recording"},
        "benchmark": {"definition", "pictures", "running"},
        "regression": {"definition", "recording", "running"},
        "checking": {"definition", "recording", "running", "regression"},
        "cli": {
            *("definition", "pictures", "recording", "running"),
            *("benchmark", "regression", "checking"),
        },
    },
}
PLACES = {
    # The bench measures what a master costs that uses FMPy as its documentation shows.
    "fmpy": ("fmus/master/fmi*.py", "fmus/master/fmu_file.py", "scenarios/benchmark/*.py"),
    "pythonfmu": ("fmus/slaves/*.py", "fmus/packaging/*.py"),
    "pythonfmu.builder": ("fmus/packaging/build.py", "fmus/packaging/bundle.py"),
    "mediapy": ("scenarios/pictures/render.py", "scenarios/pictures/stage.py"),
    "imageio_ffmpeg": ("scenarios/pictures/render.py", "scenarios/pictures/stage.py"),
    "matplotlib": ("scenarios/pictures/plot.py", "controller/design*.py", "controller/bode*.py"),
    "control": ("controller/design*.py", "controller/loop*.py"),
    "pyarrow": ("scenarios/recording/storage.py", "scenarios/regression/reference.py"),
    "typer": ("scenarios/cli/*.py",),
    "rich": ("scenarios/cli/*.py", "scenarios/benchmark/*.py"),
}
HEAVY = {
    *("numpy", "mujoco", "matplotlib", "pyarrow", "mediapy", "control", "scipy", "fmpy"),
    *("pythonfmu", "PIL", "IPython"),
}
MODULES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def imports(path: Path, *, only_at_top: bool = False) -> Iterator[str]:
    """Names of all modules that a file imports, those for type checking alone left out.

    The project's own are named from the root: `fmus.master.fmu`.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in _nodes(tree, only_at_top):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            folders = path.relative_to(ROOT).parts[:-1] if node.level else ()
            parts = [*folders[: len(folders) - node.level + 1], *(node.module or "").split(".")]
            module = ".".join(part for part in parts if part)
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def _nodes(node: ast.AST, only_at_top: bool) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield child
        is_function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
        if not (only_at_top and is_function):
            yield from _nodes(child, only_at_top)


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_imports_go_one_way(path: Path) -> None:
    layer = path.relative_to(ROOT).parts[0]
    found = {module.partition(".")[0] for module in imports(path)}
    assert found & LAYERS.keys() <= LAYERS[layer] | {layer}
    assert "tests" not in found


INNER = [path for path in MODULES if path.parent.name != "api"]  # that hands on names


@pytest.mark.parametrize("path", [p for p in INNER if p.is_relative_to(ROOT / "fmus")], ids=name)
def test_imports_within_fmus_go_one_way(path: Path) -> None:
    check_within("fmus", path)


@pytest.mark.parametrize(
    "path", [p for p in INNER if p.is_relative_to(ROOT / "scenarios")], ids=name
)
def test_imports_within_scenarios_go_one_way(path: Path) -> None:
    check_within("scenarios", path)


def check_within(layer: str, path: Path) -> None:
    """Check a module's imports of its own layer's folders."""
    folders = WITHIN[layer]
    _, folder, *rest = name(path).split("/")
    allowed = folders[folder] | {folder} if rest else set[str]()
    found = {module.split(".")[1] for module in imports(path) if module.startswith(f"{layer}.")}
    assert found & folders.keys() <= allowed


@pytest.mark.parametrize("layer", WITHIN)
def test_each_inner_folder_has_its_place(layer: str) -> None:
    assert {p.parent.name for p in (ROOT / layer).glob("*/__init__.py")} - {"api"} == WITHIN[
        layer
    ].keys()


@pytest.mark.parametrize("library", PLACES)
def test_a_foreign_library_has_one_place(library: str) -> None:
    for path in MODULES:
        used = any(m == library or m.startswith(f"{library}.") for m in imports(path))
        if used:
            assert any(fnmatch(name(path), place) for place in PLACES[library]), name(path)


def modules_after(code: str) -> set[str]:
    """Top-level modules that are loaded after some code has run in a new process."""
    program = f"{code}\nimport sys; print('LOADED', *{{m.partition('.')[0] for m in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split("LOADED ")[-1].split())


def test_help_loads_nothing_heavy() -> None:
    code = """
from panda_cosim.scenarios.cli import app
try:
    app(["--help"])
except SystemExit:
    pass
"""
    assert not modules_after(code) & HEAVY


def test_the_packages_themselves_cost_nothing() -> None:
    packages = ", ".join(
        f"panda_cosim{name}"
        for name in ("", ".scenarios", ".assets", ".fmus", *(f".fmus.{n}" for n in WITHIN["fmus"]))
    )
    assert not modules_after(f"import {packages}") & HEAVY


def test_a_run_without_pictures_loads_nothing_of_theirs() -> None:
    loaded = modules_after(
        "import panda_cosim.scenarios.running.run, panda_cosim.scenarios.cli.verdict"
    )
    assert not loaded & {"matplotlib", "mediapy", "control", "scipy", "PIL", "IPython"}
