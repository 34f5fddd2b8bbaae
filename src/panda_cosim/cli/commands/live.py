"""`panda-cosim live`."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from pathlib import Path
from shlex import quote

from ...fmus.atomic import cache_folder, temporary_folder, write_whole
from ...fmus.errors import InputError, SimulationError
from ...fmus.sources.targets import Kind, Target
from ...run.options import Options
from ...run.session import Session
from ...study.live.alone import engine_of, refuse_outside
from ...study.live.page import page_of
from ...study.live.server import LOCAL, LiveServer, opened
from ...study.live.simulation import Simulation
from ...task.scenario import Scenario
from ...task.values import Values
from .. import ending
from ..common import (
    KIND,
    OPEN_PAGE,
    OUT_RUN,
    SCENARIO_OR_DEFAULT,
    SETTINGS,
    announce_build,
    find_scenario,
    values_of,
)
from ..console import show, warn
from ..forms import flag, option


def command(  # noqa: PLR0913 - one for each option
    scenario: str = SCENARIO_OR_DEFAULT,
    out: Path | None = OUT_RUN,
    assignments: list[str] | None = SETTINGS,
    speed: float = option("--speed", 1.0, min=0.01, max=10.0),
    port: int = option("--port", 0, min=0, max=65535),
    host: str = option("--host", LOCAL),
    kind: Kind = KIND,
    paused: bool = flag("--paused"),
    duration: float | None = option("--duration SECONDS"),
    page: Path | None = option("--page FILE.html"),
    open_page: bool = OPEN_PAGE,
) -> None:
    """Run a scenario in real time, and interact with it in the browser.

    On the page you can pause, step, restart and change the speed; drag the hand or the block to
    push it, or a waypoint to move it; and change gains, other tunable parameters and the coupling.
    All actions go into a journal in the run's folder, so that `panda-cosim replay` can repeat
    the run bit for bit. Ctrl-C ends it.

    ```
    panda-cosim live --paused --open
    panda-cosim live push --speed 0.25 --port 8000
    panda-cosim live pick_and_place --page page.html
    ```

    Args:
        speed: Speed, relative to real time.
        port: Port to listen on; 0: any free one.
        host: Address to listen on. With any but the default, everyone who has the page's address
            can watch and control the run; nothing is encrypted.
        paused: Start paused, at t = 0 s.
        duration: Simulated time, instead of the scenario's.
        page: Write one HTML file that simulates in the browser, without a server, and end.
    """
    chosen = find_scenario(scenario)
    values = values_of(assignments, duration=duration)
    if page is not None:
        _write(page, chosen, Options(kind=kind), values)
        return
    if not chosen.is_system:
        announce_build(Target(kind))
    if host != LOCAL:
        warn(f"--host {host}: who has the page's address controls the run; nothing is encrypted")
    with Session(chosen, out, Options(kind=kind, waits=True), values=values) as session:
        for text in (*session.prepared.waiting, *session.warnings):
            warn(text)
        try:
            simulation = Simulation(session, speed, playing=not paused)
            server = LiveServer(simulation, page_of(session), host, port)
            _serve(server, session.folder, simulation, open_page=open_page)
        except InputError:
            if session.is_open and session.tick == 0:  # refused before anything was simulated
                session.close()
                shutil.rmtree(session.folder)
            raise
    if session.failure:
        raise SimulationError(f"{session.failure}; the recording up to then is in {session.folder}")
    show(f"{session.folder}\npanda-cosim replay {quote(str(session.folder))}  repeats it.")


def _write(page: Path, scenario: Scenario, options: Options, values: Values) -> None:
    """Write a page that simulates by itself."""
    with temporary_folder(cache_folder()) as folder:
        session = Session(scenario, folder / "run", options, values=values)
        refuse_outside(session.prepared)
        with session:
            write_whole(page, page_of(session, engine_of(session)))
    show(str(page))


def _serve(server: LiveServer, folder: Path, simulation: Simulation, *, open_page: bool) -> None:
    """Serve and simulate until Ctrl-C, which is the end that is meant."""
    with server.serving():
        try:
            show(f"{server.address}\nCtrl-C ends it. The run is recorded in {folder}")
            with opened(server.address, folder) if open_page else nullcontext():
                simulation.run(server)
        except KeyboardInterrupt:
            ending.is_meant()
