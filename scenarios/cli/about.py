"""Commands that tell what there is: `list`, `info`, `doctor`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ...fmus.errors import CosimError
from .console import show, table, tell


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command("list")(list_)
    app.command()(info)
    app.command()(doctor)


def list_() -> None:
    """List the shipped scenarios.

    ```
    panda-cosim list
    ```
    """
    from ..definition.scenario import Scenario, shipped_scenarios  # noqa: PLC0415 - after --help

    made = table(("scenario", "duration", "scene", "purpose*"), right=("duration",))
    for name, folder in shipped_scenarios().items():
        scenario = Scenario.read(folder)
        made.add_row(name, f"{scenario.duration:g} s", scenario.scene, scenario.purpose)
    show(made)


def info(
    fmu: Annotated[
        Literal["plant", "controller"] | None,
        typer.Argument(metavar="[plant|controller]", help="By default all.", show_default=False),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the variables as a Markdown table.")
    ] = False,
) -> None:
    """Show the FMUs' variables, and which output feeds which input.

    ```
    panda-cosim info controller
    ```
    """
    from ...fmus.interface.tables import INTERFACES  # noqa: PLC0415 - after --help
    from .interfaces import (  # noqa: PLC0415
        connections_table,
        variables_markdown,
        variables_tables,
    )

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


def doctor() -> None:
    """Check this machine: what is installed, what is missing, and how to get it.

    Exit code 0 means that scenarios can be run and recorded; what only pictures or other tools
    need may still be missing.

    ```
    panda-cosim doctor
    ```
    """
    from .doctor import examine  # noqa: PLC0415 - after --help

    tell("Looking around ...")
    findings = examine()
    made = table(("", "what", "found*"))
    for finding in findings:
        word, style = {
            "ok": ("ok", "green"),
            "optional": ("--", "yellow"),
            "needed": ("MISSING", "bold red"),
        }[finding.state]
        remedy = f"\n[bold]{_plain(finding.remedy)}[/bold]" if finding.remedy else ""
        made.add_row(f"[{style}]{word}[/{style}]", finding.what, _plain(finding.detail) + remedy)
    show(made)
    missing = [finding.what for finding in findings if finding.state == "needed"]
    if missing:
        raise CosimError(f"scenarios cannot be run here: {', '.join(missing)}; see the table above")
    optional = [finding.what for finding in findings if finding.state == "optional"]
    rest = f" Not at hand: {', '.join(optional)}." if optional else ""
    show(f"Scenarios can be run and recorded.{rest}", "bold green")


def _plain(text: str) -> str:
    from rich.markup import escape  # noqa: PLC0415 - after --help

    return escape(text)
