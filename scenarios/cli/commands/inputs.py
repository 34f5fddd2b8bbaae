"""`panda-cosim inputs` and `panda-cosim export`: what goes into and comes out of a run, as CSV."""

from __future__ import annotations

from pathlib import Path

from ....fmus.errors import InputError
from ...recording import Recording
from ...run.start import instants, resolve, start_values
from ...scenario.scenario import TABLE_FILE
from ...scenario.writer import write_input_csv
from ..console import show
from ..options import CSV_FILE, OVERWRITE, PARAMETERS, RUN, SCENARIO, find_scenario, overrides


def command(
    scenario: str = SCENARIO,
    file: Path = CSV_FILE,
    assignments: list[str] | None = PARAMETERS,
    overwrite: bool = OVERWRITE,
) -> None:
    """Write a scenario's commands as an FMI input file.

    The file drives the controller FMU in other tools, such as `fmpy simulate`. Its columns are the
    time and the controller's command inputs, with one row per tick.

    ```
    panda-cosim inputs tutorial commands.csv
    fmpy simulate PandaController.fmu --input-file commands.csv
    ```
    """
    chosen = find_scenario(scenario)
    if chosen.is_system:
        raise InputError(f"scenario {chosen.name!r}: commands no hand; must have a {TABLE_FILE}")
    times = instants(chosen)
    trajectory = resolve(chosen, start_values(chosen, overrides(assignments)))
    write_input_csv(file, times, trajectory.sample(times), overwrite=overwrite)
    show(f"{file}: {len(times)} rows")


def export(run: Path = RUN, file: Path = CSV_FILE, overwrite: bool = OVERWRITE) -> None:
    """Write a recording as CSV.

    One column per signal and one row per tick, in full precision (RFC 4180).

    ```
    panda-cosim export runs/first first.csv
    ```
    """
    recording = Recording.open(run, in_order=True)
    recording.to_csv(file, overwrite=overwrite)
    show(f"{file}: {recording.rows} rows, {len(recording.columns)} columns")
