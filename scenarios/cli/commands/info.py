"""`panda-cosim info`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from ....fmus.errors import InputError
from ....fmus.interface.sensors import SENSORS
from ....fmus.interface.tables import INTERFACES
from ....fmus.interface.variables import Interface
from ....fmus.master.described import described_interface
from ....fmus.master.fmu_file import Fmu
from ....fmus.messages import did_you_mean, excerpt
from ...definition.scenario import SCENARIO_FILE, Scenario
from ...running.assembly import assemble
from ..console import show, show_json
from ..interfaces import connections_table, described, variables_markdown, variables_tables
from ..options import Json


def command(
    fmu: Annotated[
        str | None,
        typer.Argument(
            metavar="[plant|controller|sensors|FILE.fmu|FOLDER]",
            help="One of the project's FMUs, any .fmu file, or a scenario's folder. Default: both.",
            show_default=False,
        ),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the variables as a Markdown table.")
    ] = False,
    json: Json = False,
) -> None:
    """Show the FMUs' variables and how they are connected.

    ```
    panda-cosim info
    panda-cosim info controller
    panda-cosim info Motor.fmu
    ```
    """
    chosen = _interfaces(fmu)
    if json:
        show_json(described(chosen))
    elif markdown:
        show("\n\n".join(variables_markdown(interface) for interface in chosen.values()))
    else:
        _show_tables(chosen)
        if fmu is not None and fmu not in INTERFACES:
            return
        show("Connections\n", "bold")
        show(connections_table(fmu))


def _interfaces(given: str | None) -> Mapping[str, Interface]:
    """Return the interfaces asked for; code in files is not run."""
    if given is None or given in INTERFACES:
        return {name: each for name, each in INTERFACES.items() if given in (None, name)}
    if given == "sensors":
        return {given: SENSORS}
    path = Path(given)
    if path.suffix == ".fmu":
        return {path.stem: described_interface(Fmu(path))}
    if (path / SCENARIO_FILE).is_file():
        return assemble(Scenario.read(path), run_code=False).interfaces
    raise InputError(
        f"{excerpt(given)}: must be {', '.join(INTERFACES)}, sensors, an .fmu file or a "
        "scenario's folder"
        f"{did_you_mean(given, INTERFACES)}"
    )


def _show_tables(interfaces: Mapping[str, Interface]) -> None:
    for name, interface in interfaces.items():
        show(f"{interface.model} (instance {name}): {interface.description}", "bold")
        for made in variables_tables(interface):
            show(made)
        show("")
