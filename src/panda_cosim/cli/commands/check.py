"""`panda-cosim check`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import typer
from rich.text import Text

from ...fmus.errors import InputError
from ...result.judging.advice import Level
from ...result.recording.logs import SUFFIXES
from ...study.check.diagnosis import Diagnostic, check_folder
from ...study.check.experiments import check_experiments
from ...study.check.motion import check_motion
from ...task.scenario import load_scenario
from ...task.values import Values
from ..common import CONTROLLER, JSON, PLANT, ROBOT, SETTINGS, SSV, Robot, end, values_of
from ..console import show_result
from ..forms import scenario_argument
from ..outcome import STYLES

FILES: Final = {".fmu", ".ssp", *SUFFIXES}  # other than folders of scenarios


def command(  # noqa: PLR0913 - one for each option
    folder: Path = scenario_argument(),
    assignments: list[str] | None = SETTINGS,
    controller: str | None = CONTROLLER,
    plant: str | None = PLANT,
    robot: Robot | None = ROBOT,
    ssv: Path | None = SSV,
    json: bool = JSON,
) -> None:
    """Explain what is wrong with a scenario, before it is run.

    The trajectory is compared with the robot's limits of velocity, acceleration, jerk, torque and
    torque rate. Then the scenario is run in memory, which shows unwanted contacts, saturated
    servos, a high torque rate, a weak grip, a hand that moves on before the block is free, and
    missed criteria. A scenario with FMUs of its own is only read: none of their code runs.

    With `--robot fer` (Panda) or `--robot fr3`, it also says what the control interface of that
    robot would refuse: libfranka's name of the error, the first time, value, limit, and what to
    change.

    Exit code 0: the scenario can be run (there may be hints). Exit code 2: it cannot, or a
    criterion or the robot's conditions could not be measured. Exit code 3: the robot would refuse
    it.

    Of a motion, a .csv or .parquet file with the columns `time`, `q1` to `q7` and perhaps `qd1` to
    `qd7`, or the JointTrajectory messages of an .mcap file, it says the same: that robot would be
    sent it each millisecond, with splines between the rows.

    Of an .fmu, the reference experiments are run (FMI-LS-REF; `build` and `mjcf2fmu` embed one),
    and the largest difference is printed, with the number of values that were compared, and of
    those that are at no instant of the run. Exit code 3: it is beyond the tolerance. Exit code 2:
    an experiment has nothing that could be compared.

    ```
    panda-cosim check my-scenarios/lift
    panda-cosim check pick_and_place --robot fr3
    panda-cosim check my-scenarios/lift --set plant.block_mass=2 --set mismatch.preset=worn
    panda-cosim check motion.csv --robot fr3
    panda-cosim check Feedthrough.fmu
    panda-cosim check Panda.ssp
    ```

    Args:
        folder: Name of a shipped scenario, a scenario's folder, an .fmu or .ssp file, or a
            motion: .csv, .parquet or .mcap.
    """
    if not folder.is_dir() and folder.suffix not in FILES:
        folder = load_scenario(str(folder)).folder or folder
    if folder.suffix == ".fmu":
        if any((assignments, controller, plant, robot, ssv)):
            raise InputError(f"{folder}: takes --json alone; experiments set their own values")
        _check_fmu(folder, json=json)
        return
    found = _found(folder, values_of(assignments, controller, plant), robot, ssv)
    levels = {diagnostic.level for diagnostic in found}
    content = {"folder": folder, "ok": "wrong" not in levels, "findings": found}
    show_result(content, (_line(each.level, each.text) for each in found), json=json)
    if "wrong" in levels:
        raise typer.Exit(InputError.exit_code)
    end(missed="refused" in levels)


def _line(level: Level, text: object) -> Text:
    return Text(f"{level:<6} {text}", STYLES[level])


def _found(
    folder: Path, values: Values, robot: Robot | None, ssv: Path | None
) -> Sequence[Diagnostic]:
    """Return what is to be said of a scenario, an .ssp file or a motion."""
    if folder.suffix not in SUFFIXES:
        return check_folder(folder, values, robot or "", ssv)
    if values:
        raise InputError(f"{folder}: --set: not for a motion")
    return [*check_motion(folder, robot)]


def _check_fmu(path: Path, *, json: bool) -> None:
    """Run the experiments in an FMU, and print how far it is from their references."""
    outcomes = check_experiments(path)
    if not outcomes:
        raise InputError(f"{path}: no experiments, so that nothing was compared")
    found = [{**asdict(each), "ok": each.ok} for each in outcomes]
    is_ok = all(each["ok"] for each in found)
    content = {"fmu": path, "ok": is_ok, "experiments": found}
    show_result(content, (_line(each.level, each) for each in outcomes), json=json)
    if not all(each.values for each in outcomes):
        nothing = "has no references at its instants, so that nothing was compared"
        raise InputError(f"{path}: an experiment {nothing}")
    end(missed=not is_ok)
