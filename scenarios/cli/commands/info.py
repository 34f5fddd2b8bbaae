"""`panda-cosim info`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from ....fmus.errors import InputError
from ....fmus.files.fmu_file import Fmu, described_interface
from ....fmus.interface.sensors import SENSORS
from ....fmus.interface.tables import CONNECTIONS, INTERFACES, Connection
from ....fmus.interface.variables import Interface
from ....fmus.messages import did_you_mean, excerpt
from ...scenario.scenario import SCENARIO_FILE, Scenario
from ...system.assembly import Assembly, assemble
from ...system.parts import UnreadSlaveError
from ...system.system_run import system_scenario
from ..console import show, show_json
from ..interfaces import connections_table, described, variables_markdown, variables_tables
from ..options import Json


def command(
    fmu: Annotated[
        str | None,
        typer.Argument(
            metavar="[plant|controller|sensors|FILE.fmu|FILE.ssp|FOLDER]",
            help="One of the project's FMUs, any .fmu or .ssp file, or a scenario's folder. "
            "Default: plant and controller.",
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
    panda-cosim info ./my-scenario
    ```
    """
    chosen, connections = _read(fmu)
    if json:
        show_json(described(chosen, connections))
    elif markdown:
        show("\n\n".join(variables_markdown(interface) for interface in chosen.values()))
    else:
        _show_tables(chosen)
        if connections:
            show("Connections\n", "bold")
            own = fmu is None or fmu in INTERFACES
            show(connections_table(fmu) if own else connections_table(None, connections))


def _read(given: str | None) -> tuple[Mapping[str, Interface], Sequence[Connection]]:
    """Return FMUs and connections; files are read, and no code in them is run."""
    if given is None or given in INTERFACES:
        chosen = {name: each for name, each in INTERFACES.items() if given in (None, name)}
        return chosen, CONNECTIONS
    if given == "sensors":
        return {given: SENSORS}, ()
    path = Path(given)
    if path.suffix == ".fmu":
        return {path.stem: described_interface(Fmu(path))}, ()
    if path.suffix == ".ssp":
        found = assemble(system_scenario(path))
    elif (path / SCENARIO_FILE).is_file():
        found = _assembled(path)
    else:
        raise InputError(
            f"{excerpt(given)}: must be {', '.join(INTERFACES)}, sensors, an .fmu or .ssp file, or "
            f"a scenario's folder{did_you_mean(given, INTERFACES)}"
        )
    return found.interfaces, found.connections


def _assembled(folder: Path) -> Assembly:
    try:
        return assemble(Scenario.read(folder), run_code=False)
    except UnreadSlaveError as error:
        raise InputError(
            f"{error}; `panda-cosim build --slave FILE.py:CLASS` makes an FMU that can be shown"
        ) from None


def _show_tables(interfaces: Mapping[str, Interface]) -> None:
    for name, interface in interfaces.items():
        show(f"{interface.model} (instance {name}): {interface.description}", "bold")
        for made in variables_tables(interface):
            show(made)
        show("")
