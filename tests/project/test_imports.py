"""The import contracts and style rules hold, and nothing heavy is loaded early."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

from bounded import ran

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
HEAVY = {
    *("numpy", "mujoco", "matplotlib", "pyarrow", "mediapy", "control", "scipy", "fmpy"),
    *("pythonfmu", "PIL", "IPython"),
}


def lint_imports(root: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts on a copy of the project."""
    command = [BIN / "lint-imports", "--no-cache", "--config", ROOT / "pyproject.toml"]
    environment = os.environ | {"PYTHONPATH": str(root / "src")}
    return ran(command, cwd=root, env=environment, code=None)


def test_the_import_contracts_hold():
    done = lint_imports(ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


FORBIDDEN = (
    ("plant/plant.py", "from ..fmus import errors", "The folders are layers BROKEN"),
    ("fmus/interface/tables.py", "from ..master import fmu", "within fmus are layers BROKEN"),
    ("src/panda_cosim/task/files.py", "import fmpy", "is imported in one place BROKEN"),
)


def test_forbidden_imports_are_seen(tmp_path):
    for folder in ("assets", "plant", "controller", "fmus", "src"):
        ignored = shutil.ignore_patterns("__pycache__", "*.parquet", "native")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored, symlinks=True)
    for module, statement, _ in FORBIDDEN:
        with (tmp_path / module).open("a", encoding="utf-8") as file:
            file.write(f"{statement}\n")
    done = lint_imports(tmp_path)
    assert done.returncode == 1
    assert all(contract in done.stdout for _, _, contract in FORBIDDEN)


def modules_after(code: str) -> set[str]:
    """Top-level modules that are loaded after some code has run in a new process."""
    program = f"{code}\nimport sys; print('LOADED', *{{m.partition('.')[0] for m in sys.modules}})"
    done = ran([sys.executable, "-c", program])
    return set(done.stdout.split("LOADED ")[-1].split())


def test_help_loads_nothing_heavy():
    code = "from contextlib import suppress\nfrom panda_cosim.cli.app import app\n"
    assert not modules_after(f"{code}with suppress(SystemExit):\n    app(['--help'])") & HEAVY


def test_the_packages_themselves_cost_nothing():
    folders = "task run study assets fmus fmus.interface fmus.inside fmus.master"
    code = ", ".join(f"panda_cosim.{name}" for name in folders.split())
    assert not modules_after(f"import {code}") & HEAVY


# No test waits without an end: one process that hangs would hold up all tests.

FILES = sorted(Path(__file__).parents[1].rglob("*.py"))
RUNS = ("subprocess.run", "subprocess.check_output", "subprocess.check_call")
WAITS = ("wait", "communicate", "join")  # without arguments: without an end
FORKS = "fmu_support.py"  # and ends with its test


def without_end(call: ast.Call, file: str) -> bool:
    """Whether a call may wait for ever, as far as its text tells."""
    function, named = ast.unparse(call.func), {each.arg for each in call.keywords}
    if "preexec_fn" in named:  # hangs now and then where there are threads
        return True
    if function in RUNS:
        return "timeout" not in named
    if function in ("os.fork", "os.wait", "os.waitpid"):  # of a process with threads, likewise
        return file != FORKS
    waits = isinstance(call.func, ast.Attribute) and call.func.attr in WAITS
    return waits and not call.args and "timeout" not in named


def test_every_wait_has_an_end():
    nodes = ((path, node) for path in FILES for node in ast.walk(ast.parse(path.read_bytes())))
    calls = ((path, node) for path, node in nodes if isinstance(node, ast.Call))
    endless = [f"{p}:{c.lineno}: {ast.unparse(c)}" for p, c in calls if without_end(c, p.name)]
    assert endless == [], "give it a timeout; see bounded.py"
