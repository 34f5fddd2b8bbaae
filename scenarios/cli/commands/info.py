"""`panda-cosim info`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ....fmus.interface.tables import INTERFACES
from ..console import show
from ..interfaces import connections_table, variables_markdown, variables_tables


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
) -> None:
    """Show the FMUs' variables and how they are connected.

    ```
    panda-cosim info
    panda-cosim info controller
    ```
    """
    if markdown:
        chosen = [i for instance, i in INTERFACES.items() if fmu in (None, instance)]
        show("\n\n".join(variables_markdown(interface) for interface in chosen))
        return
    for instance, interface in INTERFACES.items():
        if fmu in (None, instance):
            show(f"{interface.model} (instance {instance}): {interface.description}", "bold")
            for made in variables_tables(interface):
                show(made)
            show("")
    show("Connections\n", "bold")
    show(connections_table(fmu))
