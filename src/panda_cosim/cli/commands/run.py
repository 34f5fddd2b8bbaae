"""`panda-cosim run` and `panda-cosim replay`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from ...fmus.errors import InputError
from ...fmus.master.step import Coupling, Stepper
from ...fmus.sources.targets import Kind
from ...run.execution import Execution, Progress
from ...run.finished import Run
from ...run.options import Options
from ...run.prepare import prepare
from ...run.stopping import stopping_on_signals
from ...run.system.assembly import system_scenario, with_parameter_set
from ...task.scenario import Scenario
from ..common import (
    CONTROLLER,
    DEFAULT_SCENARIO,
    ISOLATE,
    JSON,
    JUNIT,
    KIND,
    MUJOCO,
    OUT_RUN,
    PLANT,
    PLOT,
    SETTINGS,
    SSV,
    STEP_TIMEOUT,
    VIDEO,
    VIEW,
    find_scenario,
    values_of,
)
from ..console import tell
from ..forms import argument, flag, option, scenario_argument
from ..outcome import Output, draw_view, perform


def command(  # noqa: PLR0913 - one for each option
    scenario: str | None = scenario_argument(None),
    out: Path | None = OUT_RUN,
    assignments: list[str] | None = SETTINGS,
    duration: float | None = option("--duration SECONDS"),
    coupling: Coupling | None = option("--coupling NAME"),
    realtime: bool = flag("--realtime"),
    video: bool = VIDEO,
    fps: float = option("--fps HZ", 30.0, min=1),
    plot: bool | None = PLOT,
    view: bool = VIEW,
    controller: str | None = CONTROLLER,
    plant: str | None = PLANT,
    system: Path | None = option("--system FILE.ssp"),
    isolate: bool = ISOLATE,
    step_timeout: float | None = STEP_TIMEOUT,
    master: Stepper = option("--master NAME", "kernel"),
    ssv: Path | None = SSV,
    log: list[str] | None = option("--log FMU"),
    profile: bool = flag("--profile"),
    kind: Kind = KIND,
    mujoco: str = MUJOCO,
    junit: Path | None = JUNIT,
    json: bool = JSON,
) -> None:
    """Run a scenario, record it and judge it.

    SCENARIO is the name of a shipped scenario (see `panda-cosim list`), a folder of your own, or an
    .ssp file. FMUs are built when they are missing or out of date. The run's folder gets
    recording.parquet, summary.json, view.html, plot.png, contact_sheet.png, video.mp4 and a copy of
    the scenario. `panda-cosim replay` repeats a run of `live`.

    ```
    panda-cosim run
    panda-cosim run tutorial --no-video
    panda-cosim run --set 'plant.block_pos[1]=0.45' --set controller.kp=6
    panda-cosim run ./my-scenario --no-video --junit result.xml
    panda-cosim run tutorial --controller my_law.py:MyLaw --set controller.gain=3
    panda-cosim run Panda.ssp --duration 2
    ```

    Args:
        scenario: Name of a shipped scenario, a folder, or an .ssp file. Default: pick_and_place.
        duration: Simulated time [s].
        coupling: Overrides the scenario's coupling: gauss-seidel, jacobi (the controller's output
            acts one tick later) or iterated.
        realtime: Run in real time, paced by the wall clock.
        fps: Frames per second of the video; 60 takes twice as long.
        system: Replace the `system` of SCENARIO, which judges it. Without SCENARIO, as `run
            FILE.ssp`.
        master: What steps the FMUs, with equal bits: kernel, in C where it can, or fmpy, by FMPy's
            methods.
        log: Show all that an FMU logs, its debug messages, too, on standard error. May repeat.
        profile: Measure the time of each FMU by call; it stands in the summary and on the page.
    """
    options = Options(
        realtime=float(realtime),
        isolate=isolate,
        step_timeout=step_timeout,
        kind=kind,
        master=master,
        log=log or (),
        profile=profile,
        waits=True,
    )
    chosen = _chosen(scenario, system, duration)
    if chosen.system and kind != Options().kind:
        raise InputError(f"--kind: does not apply to {chosen.system}, which has its own FMUs")
    values = values_of(assignments, controller, plant, coupling=coupling, duration=duration,
                       mujoco=mujoco or None)  # fmt: skip
    prepared = prepare(with_parameter_set(chosen, ssv, values, kind), options)  # refuses bad input
    is_alone = realtime or bool(prepared.listening)
    output = Output(out, video, plot, view, junit, json, fps, realtime, is_alone)

    def run(folder: Path, update: Progress) -> Run:
        with stopping_on_signals() as stop, Execution(prepared, folder) as execution:
            for line in prepared.waiting:
                tell(line)
            execution.advance(stop=stop, progress=update)
            return execution.close(stop=stop, meanwhile=partial(draw_view, output))

    perform(prepared.scenario, kind, output, run, prepared.values)


def replay(  # noqa: PLR0913 - one for each option
    run: Path = argument("RUN", show_default=False),
    out: Path | None = OUT_RUN,
    video: bool = VIDEO,
    plot: bool | None = PLOT,
    view: bool = VIEW,
    isolate: bool = ISOLATE,
    step_timeout: float | None = STEP_TIMEOUT,
    junit: Path | None = JUNIT,
    json: bool = JSON,
) -> None:
    """Repeat a run of `live` or of a Session, bit for bit.

    Scenario, FMUs and actions are those of the run's journal. The results are those of
    `panda-cosim run`.

    ```
    panda-cosim replay runs/my-session
    ```

    Args:
        run: Folder of the run, or the journal session.jsonl in it.
    """
    from ...run import replay as journal  # noqa: PLC0415 - `run` has no use for it

    options = Options(isolate=isolate, step_timeout=step_timeout)
    scenario, options = journal.read_session(run, options)
    output = Output(out, video, plot, view, junit, json)

    def repeat(folder: Path, update: Progress) -> Run:
        return journal.replay(run, folder, options, progress=update)

    perform(scenario, options.kind, output, repeat)


def _chosen(name: str | None, system: Path | None, duration: float | None) -> Scenario:
    """Return a scenario, or what runs the system of an .ssp file, which a scenario may judge."""
    if system is None and Path(name or "").suffix == ".ssp":
        system, name = Path(str(name)), None
    if system is None:
        return find_scenario(name or DEFAULT_SCENARIO)
    alone = system_scenario(system, duration)
    if name is None:
        return alone
    judging = find_scenario(name)
    if not judging.system:
        raise InputError(
            f"SCENARIO {name!r}: cannot be combined with --system; must be one with a `system`"
        )
    return replace(judging, system=alone.system, folder=alone.folder)
