"""What all tests share."""

import atexit
import os
import shutil
import signal
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkdtemp

import pytest

# Where there is no C compiler, ziglang, which comes with the tests, is `cc`.
if not any(map(shutil.which, ("cc", "gcc", "clang"))) and find_spec("ziglang"):
    LENT = Path(mkdtemp()) / "cc"
    LENT.write_text(
        f'#!/bin/sh\nexec {sys.executable} -m ziglang cc -mcpu=baseline -fno-sanitize=all "$@"\n'
    )
    LENT.chmod(0o755)
    atexit.register(shutil.rmtree, LENT.parent)
    os.environ["PATH"] += f"{os.pathsep}{LENT.parent}"

# Scripts, and programs of scenarios, call `panda-cosim` and `python` by name.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

# Each test process has a core: NumPy's own threads would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# So that tests find the modules beside them, and the studies.
sys.path.insert(0, str(Path(__file__).parents[1] / ".ci" / "studies"))
sys.path.insert(0, str(Path(__file__).parent))

from hypothesis import HealthCheck, settings

import forked
from browser import browser, find_browser
from fmu_support import JobError, in_fork

# A machine may be busy, and fixtures are the same for all examples.
settings.register_profile(
    "tests", deadline=None, max_examples=30, suppress_health_check=list(HealthCheck)
)
settings.load_profile("tests")

# Files of half a minute each. They begin first, so that none is left for one process at the end;
# the very first is the one for which ziglang may have to compile what Windows takes, for minutes.
LONGEST = (
    "test_regress", "test_view_page", "test_engines", "test_live", "test_sweep_run",
    "test_fmu_importers", "test_run_faults", "test_analysis", "test_cli", "test_contributing",
    "test_parts", "test_render", "test_experiments", "test_native_c", "test_route", "test_install",
    "test_native_cross", "test_growth", "test_fmu_package", "test_report",
)  # fmt: skip
os.environ.pop("COLUMNS", None)  # xdist sets it, and tables in a pipe would be narrower than alone
# Hundreds of processes would compile the package anew, and each worker the tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_configure(config: pytest.Config) -> None:
    """Let xdist keep files whole and in order, and commands listen to Ctrl-C."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as in a job in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False
    # What `-n` alone means; with it, two processes would make a file's fixtures.
    if getattr(config.option, "dist", "") == "load":
        config.option.dist = "loadfile"


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Run two processes more than there are cores, as many tests wait for others."""
    return (os.cpu_count() or 1) + 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; tests marked as long take as long as they take."""
    order = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.timeout(0))


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test marked `own_process` in a forked process, which gets all that its FMUs load."""
    if pyfuncitem.get_closest_marker("own_process") is None:
        return None
    values = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    try:
        in_fork(pyfuncitem.obj, **values)
    except JobError as error:
        failure = str(error)
    else:
        return True
    pytest.fail(failure, pytrace=False)


@pytest.fixture(scope="module")
def forked_workers():
    """Have the tests of a file fork the workers of their sweeps."""
    with forked.workers():
        yield


@pytest.fixture(scope="session")
def page(tmp_path_factory):
    """A page in Chromium; all tests show theirs in it, one after another."""
    if find_browser() is None:
        pytest.skip("no Chromium here")
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened
