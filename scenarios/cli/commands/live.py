"""`panda-cosim live`."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from ....fmus.packaging.build import Target
from ...live.page import page_of
from ...live.server import LOCAL, LiveServer
from ...live.simulation import Simulation
from ...running.assembly import instances
from ...running.run import Options
from ...running.session import Session
from ..console import show, warn
from ..options import Assignments, Kind, ScenarioName, find_scenario, overrides
from .build import announce_build

DEFAULT = "pick_and_place"  # scenario


def command(  # noqa: PLR0913 - one for each option
    scenario: ScenarioName = DEFAULT,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR", help="New folder of the run. Default: in runs/."
        ),
    ] = None,
    assignments: Assignments = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.01, max=10.0, help="Relative to the wall clock.")
    ] = 1.0,
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="To listen on; 0: any free one.")
    ] = 0,
    host: Annotated[
        str,
        typer.Option(
            "--host",
            help="Address to listen on. Any but the default lets other machines look and act, "
            "unencrypted, if they have the page's address.",
        ),
    ] = LOCAL,
    kind: Kind = "native",
    open_page: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
) -> None:
    """Run a scenario in real time in the browser, and act on it while it goes on.

    Pause, step, change the speed, restart; drag the hand to push it; change gains, other tunable
    parameters and the coupling. What is done is kept in the run's folder with its tick, and
    `panda-cosim run --session` runs it again, bit for bit. Ctrl-C ends it.

    ```
    panda-cosim live --open
    panda-cosim live push --speed 0.25 --port 8000
    ```
    """
    chosen = find_scenario(scenario)
    options = Options(overrides=overrides(assignments, instances(chosen)), kind=kind)
    if not chosen.is_system:
        announce_build(Target(kind))
    if host != LOCAL:
        warn(
            f"--host {host}: whoever reaches this address and has the page's token may look and "
            "act; nothing is encrypted"
        )
    with Session(chosen, out, options) as session:
        simulation = Simulation(session, speed)
        server = LiveServer(simulation, page_of(session), host, port)
        with server.serving(), suppress(KeyboardInterrupt):
            show(f"{server.address}\nCtrl-C ends it.")
            if open_page:
                webbrowser.open(server.address)
            simulation.run(server)
        session.close()
    show(f"{session.folder}\npanda-cosim run --session {session.folder}  runs it again.")
