"""README, reference and notebook say what is so: commands, scenario files, links."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import fields
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from bounded import ran
from panda_cosim import Scenario
from panda_cosim.cli.commands import COMMANDS
from panda_cosim.task.criteria import Success
from panda_cosim.task.table import COLUMNS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted((ROOT / "docs" / "reference").glob("*.md"))
REFERENCE = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
SCENARIO = (ROOT / "docs" / "reference" / "scenario.md").read_text(encoding="utf-8")
NOTEBOOK = ROOT / "scenarios" / "examples" / "first_steps.ipynb"


def blocks(kind: str, text: str = README) -> list[str]:
    """Code blocks of one kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_every_command_is_in_the_table():
    page = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    assert all(f"| `panda-cosim {name}" in page for name in COMMANDS)


def test_the_example_scenario_can_be_read(tmp_path):
    (tmp_path / "scenario.toml").write_text(blocks("toml", SCENARIO)[0], encoding="utf-8")
    (tmp_path / "trajectory.csv").write_text(blocks("csv", SCENARIO)[0], encoding="utf-8")
    scenario = Scenario.read(tmp_path)
    assert scenario.success.min_lift == 0.15
    assert len(scenario.success.signal) == 1


def test_every_key_and_column_of_a_scenario_is_named():
    keys = {entry.name for entry in (*fields(Scenario), *fields(Success))}
    missing = {key for key in keys if not re.search(rf"\b{key}\b", REFERENCE)}
    assert missing <= {
        "name",
        "table",
        "input_table",
        "folder",
    }  # where it is, not what is in its file
    table = SCENARIO.partition("| column | meaning |")[2]
    assert all(f"`{column}`" in table for column in COLUMNS)


def headings(text: str) -> set[str]:
    """Anchors of a page's headings."""
    found = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("name", ["README.md", "SECURITY.md", "CONTRIBUTING.md"])
def test_every_link_leads_somewhere(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    for target, _, anchor in re.findall(r"\]\((?!https?://)([^)#]*)(#([^)]+))?\)", text):
        assert not target or (ROOT / target).exists(), target
        if anchor and (not target or target.endswith(".md")):
            page = (ROOT / target).read_text(encoding="utf-8") if target else text
            assert anchor in headings(page), f"{target}#{anchor}"


def test_the_example_of_a_model_runs_anywhere(tmp_path):
    example = next(block for block in blocks("sh") if "pendulum.xml" in block)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = ran(["sh", "-e"], input=example, cwd=tmp_path, env=os.environ | {"PATH": path})
    assert "Angle of joint hinge" in done.stdout


@pytest.mark.long
def test_the_notebook_runs_and_shows_what_it_says(tmp_path):
    pytest.importorskip("pandas")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    shown = {
        cell.source: output.data
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type == "execute_result"
    }
    kinds = {source.splitlines()[-1]: set(data) for source, data in shown.items()}
    assert "text/html" in kinds["run"]
    assert "image/png" in kinds["run.plot()"]
    assert "text/html" in kinds["run.view(height=480)"]
    assert "text/html" in kinds["compared"]
    table = next(data for source, data in shown.items() if source.startswith("gains ="))
    assert "success" in table["text/plain"]  # with the scenario's gain
    assert "missed" in table["text/plain"]  # with half of it the hand lags
