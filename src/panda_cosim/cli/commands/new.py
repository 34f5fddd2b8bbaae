"""`panda-cosim new`, `panda-cosim list` and `panda-cosim inputs`."""

from __future__ import annotations

from pathlib import Path

from ...fmus.errors import InputError
from ...run.start import instants, resolve, start_values
from ...study.check.experiments import import_experiment
from ...task.files import as_argument
from ...task.scenario import TABLE_FILE, Scenario, shipped_scenarios
from ...task.writer import make_scenario, write_input_csv
from ..common import JSON, OVERWRITE, SCENARIO, SETTINGS, find_scenario, values_of
from ..console import show, show_result, table
from ..forms import argument, flag, option


def command(  # noqa: PLR0913 - one for each option
    name: Path = argument("NAME"),
    source: str | None = option("--from SCENARIO"),
    law: bool = flag("--law --controller"),
    plant: bool = flag("--plant"),
    slave: bool = flag("--slave"),
    sweep: bool = flag("--sweep"),
    franka: bool = flag("--franka"),
) -> None:
    """Create a scenario of your own, ready to run.

    A scenario is a folder with a table of waypoints, trajectory.csv, and a file of settings,
    scenario.toml. With `--franka`, a program on libfranka moves the arm instead of the table.

    ```
    panda-cosim new my-scenarios/lift
    panda-cosim run my-scenarios/lift
    panda-cosim new my-law --law --sweep
    panda-cosim new my-gust --slave
    panda-cosim new my-robot --franka
    panda-cosim new my-push --from push
    panda-cosim new their-test --from Theirs.fmu
    ```

    Args:
        name: Folder to create.
        source: Copy a shipped scenario, without its reference; or run the experiment in an X.fmu.
        law: Add a control law in Python, for you to edit.
        plant: Add a scene of your own with one more body, for you to edit.
        slave: Add a slave for PythonFMU, which blows at the hand.
        sweep: Add a sweep, which `regress` judges, too.
        franka: Add a program on pylibfranka that picks the block up, for you to edit.
    """
    parts = {"law": law, "plant": plant, "slave": slave, "sweep": sweep, "franka": franka}
    if source is not None and source.endswith(".fmu"):
        if sweep:
            raise InputError("--from X.fmu: cannot be combined with --sweep")
        made, judged = import_experiment(Path(source), name)
    else:
        made, judged = make_scenario(name, [part for part in parts if parts[part]], source), ""
    for text in (*map(str, made), *filter(None, [judged])):
        show(text)
    folder = as_argument(name)
    more = f"; panda-cosim sweep {folder}/sweep.toml" if sweep else ""
    show(f"Next: panda-cosim check {folder}; panda-cosim run {folder}{more}", "dim")


def list_scenarios(json: bool = JSON) -> None:
    """List the shipped scenarios.

    ```
    panda-cosim list
    ```
    """
    scenarios = [Scenario.read(path) for path in shipped_scenarios().values()]
    keys = {"name": "name", "duration_s": "duration", "scene": "scene", "purpose": "purpose",
            "folder": "folder"}  # fmt: skip
    content = [{key: getattr(s, name) for key, name in keys.items()} for s in scenarios]
    rows = [(s.name, f"{s.duration:g} s", s.scene, s.purpose) for s in scenarios]
    listed = table(("scenario", "duration", "scene", "purpose*"), rows, right=("duration",))
    show_result(content, [listed], json=json)


def inputs(
    scenario: str = SCENARIO,
    file: Path = argument("FILE.csv"),
    assignments: list[str] | None = SETTINGS,
    overwrite: bool = OVERWRITE,
) -> None:
    """Write a scenario's commands as an FMI input file.

    The file drives the controller FMU in other tools, such as `fmpy simulate`. Its columns are the
    time and the controller's command inputs, with one row per tick.

    ```
    panda-cosim inputs tutorial commands.csv
    fmpy simulate PandaController.fmu --input-file commands.csv
    ```

    Args:
        file: The file to write.
    """
    chosen = find_scenario(scenario).changed(values_of(assignments))
    if not chosen.is_commanded:
        raise InputError(f"scenario {chosen.name!r}: commands no hand; must have a {TABLE_FILE}")
    times = instants(chosen)
    trajectory = resolve(chosen, start_values(chosen))
    write_input_csv(file, times, trajectory.sample(times), overwrite=overwrite)
    show(f"{file}: {len(times)} rows")
