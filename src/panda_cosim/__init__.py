"""FMI co-simulation of a Franka Emika Panda that picks up a block and sets it on a table.

```python
from panda_cosim import run_scenario

run = run_scenario("pick_and_place")
print(run.summary.success, run.summary.tracking["rms_mm"])
```

The public names are imported when first used, so that `import panda_cosim` costs nothing.
"""

# `python -m panda_cosim` runs this while the working directory is still on sys.path (see __main__),
# so only modules that Python has already imported may be imported here.
TYPE_CHECKING = False
if TYPE_CHECKING:  # what type checkers know of the names below
    from panda_cosim.fmus.errors import CosimError as CosimError
    from panda_cosim.fmus.errors import InputError as InputError
    from panda_cosim.fmus.errors import SimulationError as SimulationError
    from panda_cosim.result.recording.reader import Recording as Recording
    from panda_cosim.run.execution import run_scenario as run_scenario
    from panda_cosim.run.finished import Run as Run
    from panda_cosim.run.options import Options as Options
    from panda_cosim.run.replay import replay as replay
    from panda_cosim.run.session import Session as Session
    from panda_cosim.study.analysis.loops import Analysis as Analysis
    from panda_cosim.study.analysis.loops import analyze as analyze
    from panda_cosim.study.compare.between_runs import RunComparison as RunComparison
    from panda_cosim.study.compare.between_runs import compare as compare
    from panda_cosim.study.sweep.definition import Sweep as Sweep
    from panda_cosim.study.sweep.sweeping import sweep as sweep
    from panda_cosim.task.criteria import SignalCriterion as SignalCriterion
    from panda_cosim.task.criteria import Success as Success
    from panda_cosim.task.scenario import Push as Push
    from panda_cosim.task.scenario import Scenario as Scenario
    from panda_cosim.task.scenario import load_scenario as load_scenario
    from panda_cosim.task.scenario import shipped_scenarios as shipped_scenarios
    from panda_cosim.task.table import TableRow as TableRow
    from panda_cosim.task.table import TrajectoryTable as TrajectoryTable
    from panda_cosim.task.trajectory import Trajectory as Trajectory

_NAMES = {
    "fmus.errors": "CosimError InputError SimulationError",
    "study.analysis.loops": "Analysis analyze",
    "study.compare.between_runs": "RunComparison compare",
    "result.recording.reader": "Recording",
    "run.options": "Options",
    "run.replay": "replay",
    "run.finished": "Run",
    "run.execution": "run_scenario",
    "run.session": "Session",
    "task.criteria": "SignalCriterion Success",
    "task.scenario": "Push Scenario load_scenario shipped_scenarios",
    "task.table": "TableRow TrajectoryTable",
    "task.trajectory": "Trajectory",
    "study.sweep.definition": "Sweep",
    "study.sweep.sweeping": "sweep",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> object:
    """Import a public name's module when the name is first used."""
    from importlib import import_module  # noqa: PLC0415 - see the comment above

    if name == "__all__":
        return __dir__()
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - see the comment above

        return version("panda-cosim")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return sorted(["__version__", *_MODULES])
