"""Turns scenarios into tests: `pytest --panda-scenarios DIR` collects one for each in DIR.

Sweeps are in `sweep/pytest_plugin.py`. The fixture `scenario_run` runs a scenario in a test.

A test passes if the run matches its reference or, without one, if its verdict is the expected one,
see `panda-cosim regress`. Scenarios run side by side from the first test on, `--panda-jobs` at a
time.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from ...task.scenario import Scenario
    from ...task.values import Values
    from .outcome import Outcome

SCENARIO_FILE = "scenario.toml"
pytest_plugins = ("panda_cosim.study.sweep.pytest_plugin",)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("panda-cosim")
    text = "collect a test for each scenario folder in DIR; may be repeated"
    group.addoption(
        "--panda-scenarios", action="append", default=[], type=Path, metavar="DIR", help=text
    )
    group.addoption(
        "--panda-jobs", type=int, default=2, metavar="N", help="scenarios that run side by side"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Collect from the scenarios' folders, too."""
    for folder in config.getoption("--panda-scenarios"):
        if not folder.is_dir():
            raise pytest.UsageError(f"--panda-scenarios: {folder}: no such folder")
        config.args.append(str(folder))  # pytest collects what is named twice once


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """Make a test from a scenario file in one of the folders."""
    from ...task.files import is_copy  # noqa: PLC0415 - only where there is a scenario

    is_scenario = file_path.name == SCENARIO_FILE and not is_copy(file_path)
    if not (is_scenario and is_chosen(file_path, parent.config)):
        return None
    return ScenarioFile.from_parent(parent, path=file_path)


def is_chosen(path: Path, config: pytest.Config) -> bool:
    """Return whether a file is in one of the scenarios' folders."""
    folders = config.getoption("--panda-scenarios")
    return any(path.resolve().is_relative_to(folder.resolve()) for folder in folders)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse a folder without scenarios, before tests are selected by name."""
    if config.getoption("lf", default=False):  # leaves out folders whose tests passed
        return
    for folder in config.getoption("--panda-scenarios"):
        paths = [item.path for item in items if isinstance(item, ScenarioItem)]
        if not any(path.resolve().is_relative_to(folder.resolve()) for path in paths):
            raise pytest.UsageError(f"--panda-scenarios: {folder}: no scenario was collected")


class ScenarioFile(pytest.File):
    """A scenario's folder."""

    def collect(self) -> Iterator[ScenarioItem]:
        """Yield the one test."""
        yield ScenarioItem.from_parent(self, name=self.path.parent.name)


class JudgedItem(pytest.Item):
    """A test that passes if its outcome does."""

    def outcome(self) -> Outcome:
        """Return the outcome of what is tested."""
        raise NotImplementedError

    def runtest(self) -> None:
        """Wait for the outcome."""
        from ...result.judging.criterion import line  # noqa: PLC0415 - only where there is a scenario

        outcome = self.outcome()
        if outcome.verdict == "skipped":
            pytest.skip(outcome.error)
        if not outcome.ok:
            criteria = [f"  {line(criterion)}" for criterion in outcome.criteria]
            said = f"{outcome.name}: {outcome.verdict}: {outcome.reason}"
            pytest.fail("\n".join([said, *criteria]), pytrace=False)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return the test's name for pytest's report."""
        return self.path, None, f"scenario {self.name}"


class ScenarioItem(JudgedItem):
    """A scenario whose run must match its reference or, without one, meet its criteria."""

    def outcome(self) -> Outcome:
        """Wait for the scenario's run and compare it."""
        return _runs(self.session).outcome(self)


class TestedRun:
    """A run in a test, with the data of its `summary.json` and its recording."""

    __test__ = False  # no class of tests, though its name begins so

    def __init__(self, outcome: Outcome) -> None:
        from ...result.recording import Recording  # noqa: PLC0415 - only where there is a scenario

        self._outcome = outcome
        self.summary = outcome.summary.to_dict()
        self.recording = Recording.open(outcome.run)

    def assert_success(self) -> None:
        """Check that the scenario has criteria, and that they have the expected verdict."""
        __tracebackhide__ = True
        summary = self._outcome.summary
        if summary.verdict.level != "good":
            _fail(self._outcome, f"expected {summary.expect} by criteria of its own")

    def assert_matches_reference(self) -> None:
        """Check that each signal stays within its tube around the scenario's reference."""
        __tracebackhide__ = True
        if self._outcome.verdict != "same":
            _fail(self._outcome, "expected a reference that it matches")


def _fail(outcome: Outcome, said: str) -> None:
    """Fail with a line, and below it the criteria, problems and signals."""
    from .junit import details  # noqa: PLC0415 - only where there is a scenario

    __tracebackhide__ = True
    pytest.fail(f"{outcome.name}: {said}\n{details(outcome)}", pytrace=False)


@pytest.fixture
def scenario_run(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., TestedRun]:
    """Run scenarios: `scenario_run("push", {"controller.kp": 7})`, with keys as for `--set`."""
    from ...fmus.errors import CosimError  # noqa: PLC0415 - only where there is a scenario
    from ...task.scenario import load_scenario  # noqa: PLC0415 - see above

    numbers = count(1)

    def run(scenario: str | Path, values: Values | None = None) -> TestedRun:
        changed = load_scenario(scenario).changed(values or {})
        outcome = _runs(request.session).run(changed, tmp_path / f"run-{next(numbers)}")
        if outcome.verdict == "skipped":
            pytest.skip(outcome.error)
        if outcome.verdict == "failed":
            raise CosimError(f"{outcome.name}: {outcome.error}")
        return TestedRun(outcome)

    return run


class _Runs:
    """Runs of all chosen scenarios in a temporary folder, started when the first is needed."""

    def __init__(self, session: pytest.Session) -> None:
        from ...fmus.atomic import (  # noqa: PLC0415 - only where there is a scenario
            cache_folder,
            temporary_folder,
        )
        from ...fmus.twins import notice  # noqa: PLC0415 - see above
        from ..work import Workers  # noqa: PLC0415 - see above

        with ExitStack() as stack:
            self._folder = stack.enter_context(temporary_folder(cache_folder()))
            jobs = session.config.getoption("--panda-jobs")
            self._workers = stack.enter_context(Workers(jobs))
            session.config.add_cleanup(stack.pop_all().close)
        for text in filter(None, [notice()]):
            warnings.warn(text, stacklevel=2)
        items = [item for item in session.items if isinstance(item, ScenarioItem)]
        # Each worker of pytest-xdist has all items but runs only some: do not run the others.
        ahead = [] if hasattr(session.config, "workerinput") else items
        self._futures = {item.nodeid: self._start(item) for item in ahead}

    def outcome(self, item: ScenarioItem) -> Outcome:
        """Return the outcome of a scenario."""
        return (self._futures.get(item.nodeid) or self._start(item)).result()

    def run(self, scenario: Scenario, folder: Path) -> Outcome:
        """Run a scenario into a folder, and compare it."""
        from .regress import start  # noqa: PLC0415 - only where there is a scenario

        return start(self._workers, scenario, folder).result()

    def _start(self, item: ScenarioItem) -> Future[Outcome]:
        from .regress import read_scenario, start  # noqa: PLC0415 - only where there is a scenario

        scenario = read_scenario(item.path.parent)
        return start(self._workers, scenario, self._folder / str(id(item)) / scenario.name)


_RUNS = pytest.StashKey[_Runs]()


def _runs(session: pytest.Session) -> _Runs:
    if _RUNS not in session.config.stash:
        session.config.stash[_RUNS] = _Runs(session)
    return session.config.stash[_RUNS]
