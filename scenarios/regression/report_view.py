"""Runs of a report in 3D, each with its reference as a ghost; one script serves all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from ...fmus.errors import InputError
from ..view.export import contents, shown_run
from ..view.page import Contents, code_elements, data_elements, script_sources, style
from ..view.run import DRAWN, ROLES, RunData, Shown
from ..view.story import CURVES
from .reference_view import shown_reference

LIMITED: Final = "Curves of this report: the first ones and the worst signals; `view` shows all."
KEPT: Final = (
    *(getattr(ROLES, role) for role in DRAWN),
    *(column for _, columns in CURVES for column in columns),
    "controller.grip_cmd",  # tells when the block is let go
)


class ReportViews:
    """Collects the data of a page that shows runs in 3D."""

    def __init__(self) -> None:
        self._documents: list[Mapping[str, Any]] = []
        self._models: dict[str, Mapping[str, Any]] = {}

    def add(self, run: Path, reference: Path, name: str, columns: Sequence[str]) -> dict[str, Any]:
        """Add a run and its reference.

        Args:
            run: Folder of the run.
            reference: The file `reference.parquet`.
            name: The scenario's name, unique on the page.
            columns: Columns whose curves are shown first.

        Returns:
            `runs`: names for `PandaView.show`; or `missing`: why there is no picture.
        """
        try:
            shown = [shown_run(run, name=name), shown_reference(reference, f"reference of {name}")]
            found = contents([_limited(one, columns) for one in shown])
        except InputError as error:
            return {"runs": [], "missing": str(error)}
        own, ghost = found.documents
        self._documents += [{**own, "curves": first_curves(own, columns)}, ghost]
        self._models |= found.models
        return {"runs": list(found.runs), "missing": ""}

    @property
    def page_parts(self) -> dict[str, Any]:
        """Parts of the page for the template: policy, style, data and code; safe as HTML."""
        if not self._documents:
            return {"sources": "", "style": "", "elements": ""}
        data = data_elements(Contents("", [], self._documents, self._models))
        return {
            "sources": " ".join(script_sources()),
            "style": style(),
            "elements": f"{data}\n{code_elements()}",
        }


def first_curves(document: Mapping[str, Any], columns: Iterable[str]) -> list[dict[str, Any]]:
    """Return the curves shown first: those of the columns, then the run's own."""
    known = {name for signal in document["signals"] for name in signal["columns"]}
    worst = [{"title": name, "columns": [name]} for name in columns if name in known]
    return worst + list(document["curves"])


class _Selected:
    """A run with only some of its columns, so that a page of many runs stays small.

    Args:
        source: The run.
        kept: Names of signals and columns.
    """

    def __init__(self, source: RunData, kept: Iterable[str]) -> None:
        self._source, names = source, frozenset(kept)
        self.time, self.metadata = source.time, source.metadata
        self.units, self.descriptions = source.units, source.descriptions
        self.columns = [c for c in source.columns if c in names or c.partition("[")[0] in names]

    def __getitem__(self, name: str) -> Any:
        """Return a signal, or a column."""
        return self._source[name]


def _limited(run: Shown, columns: Iterable[str]) -> Shown:
    source = _Selected(run.source, (*KEPT, *columns))
    # Contact forces need more signals than the curves do; the full view has them.
    return replace(run, source=source, physics=None, notes=(*run.notes, LIMITED))


__all__ = ["ReportViews", "first_curves"]
