"""The notebook that the package brings runs from its first cell to its last."""

from __future__ import annotations

from pathlib import Path

import nbformat
import panda_cosim
import pytest
from nbclient import NotebookClient

NOTEBOOK = (
    Path(str(panda_cosim.__file__)).parents[1] / "examples" / "first_steps.ipynb"
)  # beside `api`


@pytest.mark.fmu
@pytest.mark.long
def test_the_notebook_runs_and_shows_what_it_says(tmp_path: Path) -> None:
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
