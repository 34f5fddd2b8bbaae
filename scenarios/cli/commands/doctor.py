"""`panda-cosim doctor`."""

from __future__ import annotations

from typing import Annotated

import typer

from ....fmus.errors import CosimError
from ..console import as_cell, show, show_json, table, tell
from ..machine import Finding, examine

# Not `options.Json`: this command must start without numpy, which `options` imports.
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
STATES = {
    "ok": "[green]ok[/green]",
    "optional": "[yellow]--[/yellow]",
    "needed": "[bold red]MISSING[/bold red]",
}


def command(json: Json = False) -> None:
    """Show what is installed, what is missing, and how to get it.

    Exit code 0: scenarios can be run and recorded, even if something for pictures or other tools is
    missing. Exit code 1: they cannot.

    ```
    panda-cosim doctor
    ```
    """
    tell("Examining this machine ...")
    findings = examine()
    missing = [finding.what for finding in findings if finding.state == "needed"]
    if json:
        show_json({"ready": not missing, "findings": findings})
    else:
        _show_findings(findings)
    if missing:
        raise CosimError(f"scenarios cannot be run here: {', '.join(missing)}")
    if json:
        return
    optional = [finding.what for finding in findings if finding.state == "optional"]
    rest = f" Not found: {', '.join(optional)}." if optional else ""
    show(f"Scenarios can be run and recorded.{rest}", "bold green")


def _show_findings(findings: list[Finding]) -> None:
    made = table(("", "what*", "found*"))
    for finding in findings:
        remedy = f"\n[bold]{as_cell(finding.remedy)}[/bold]" if finding.remedy else ""
        made.add_row(STATES[finding.state], finding.what, as_cell(finding.detail) + remedy)
    show(made)
