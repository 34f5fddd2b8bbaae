"""`panda-cosim info`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ....fmus.interface.tables import INTERFACES
from ....fmus.interface.variables import Interface
from ..console import show, show_json
from ..interfaces import connections_table, described, variables_markdown, variables_tables
from ..options import Json


def command(
    fmu: Annotated[
        Literal["plant", "controller"] | None,
        typer.Argument(
            metavar="[plant|controller]", help="Default: both FMUs.", show_default=False
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
    ```
    """
    chosen = {name: each for name, each in INTERFACES.items() if fmu in (None, name)}
    if json:
        show_json(described(chosen))
    elif markdown:
        show("\n\n".join(variables_markdown(interface) for interface in chosen.values()))
    else:
        _show_tables(chosen)
        show("Connections\n", "bold")
        show(connections_table(fmu))


def _show_tables(interfaces: dict[str, Interface]) -> None:
    for name, interface in interfaces.items():
        show(f"{interface.model} (instance {name}): {interface.description}", "bold")
        for made in variables_tables(interface):
            show(made)
        show("")
