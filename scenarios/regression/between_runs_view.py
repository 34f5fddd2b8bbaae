"""The run that differs most in 3D, with the first run as a ghost."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ...fmus.errors import InputError
from ..running.folders import SUMMARY_FILE
from ..view.export import contents, read_summary, show_source
from ..view.page import Contents, code_elements, data_elements, script_sources, show_element, style
from ..view.run import Shown
from .between_runs import RunComparison
from .report_view import first_curves

CURVES: Final = 3  # of the most different signals
NOTHING: Final = {"sources": "", "style": "", "elements": "", "words": "", "missing": ""}


def view_parts(comparison: RunComparison) -> dict[str, str]:
    """Parts of the page for the template; safe as HTML except `words` and `missing`."""
    if not comparison.signals:
        return NOTHING
    worst = comparison.signals[0]
    other = int(np.argmax(np.nan_to_num(worst.largest, nan=np.inf)))
    at = worst.times[other]
    try:
        found = contents([_shown(comparison, other + 1), _shown(comparison, 0)])
    except InputError as error:  # no model, or no positions
        return {**NOTHING, "missing": str(error)}
    run, ghost = found.documents
    first = first_curves(run, [row.name for row in comparison.signals[:CURVES]])
    documents = [{**run, "curves": first}, ghost]
    data = data_elements(Contents("", [], documents, found.models))
    shown: dict[str, Any] = {"runs": list(found.runs), "at": at, "part": True}
    return {
        "sources": " ".join(script_sources()),
        "style": style(),
        "elements": f"{data}\n{show_element(shown)}\n{code_elements()}",
        "words": f"{found.runs[0]} at t = {at:.3f} s, {found.runs[1]} as a ghost",
        "missing": "",
    }


def _shown(comparison: RunComparison, index: int) -> Shown:
    recording = comparison.recordings[index]
    summary = read_summary(recording.path.parent / SUMMARY_FILE)
    return show_source(recording, comparison.names[index], summary=summary)


__all__ = ["view_parts"]
