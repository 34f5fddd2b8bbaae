"""Runs in 3D on a page of differences, each with its reference or another run as a ghost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from ...fmus.errors import InputError
from ...result.recording import Recording
from ...result.view.columns import Json
from ...result.view.facts import CURVES
from ...result.view.page import Document, contents, data_elements, show_source
from ...result.view.run import ROLES, Shown
from ...task.scenario import shipped_scenarios
from .page import Part
from .reference import REFERENCE_FILE, Reference

ROUNDED: Final = "The reference is rounded to a tenth of its tolerances."
LIMITED: Final = "Curves of this report: the first ones and the worst signals; `view` shows all."
KEPT: Final = (
    *ROLES.values(),
    *(column for _, columns in CURVES for column in columns),
    "controller.grip_cmd",  # tells when the block is let go
)


def shown_reference(path: Path, name: str = "reference") -> Shown:
    """Return the reference in a file for the view, under a name."""
    reference = Reference.read(path)
    run = show_source(reference, name, summary=reference.summary)
    return replace(run, notes=(ROUNDED,))


def reference_of(source: Recording) -> Path:
    """Return the reference of a run's scenario."""
    name, folder = (source.metadata.get(key) for key in ("scenario", "scenario_folder"))
    place = Path(str(folder)) if folder else shipped_scenarios().get(str(name))
    if place is None:
        advice = f"does not say where it is; give the path of its {REFERENCE_FILE}"
        unknown = f"scenario {name!r} is not one of the shipped ones, and the recording"
        raise InputError(f"--against reference: {unknown} {advice}")
    return place / REFERENCE_FILE


class Views:
    """Collects the runs that a page shows in 3D; each stands in it once."""

    def __init__(self) -> None:
        self._documents: list[Document] = []
        self._models: dict[str, Json] = {}

    def add(self, runs: Iterable[Shown], columns: Sequence[str], at: float) -> Part:
        """Add a run and its ghost, whose names are unique; the columns' curves come first."""
        try:
            run, ghost = runs
            if run.model is None:
                raise InputError("its plant has no model")
            (own, other), models = contents([run, ghost])
        except InputError as error:  # no model, or no positions
            return Part("In 3D", note=f"No 3D: {error}")
        known = {name for signal in own["signals"] for name in signal["columns"]}
        worst = [{"title": name, "columns": [name]} for name in columns if name in known]
        self._documents += [{**own, "curves": [*worst, *own["curves"]]}, other]
        self._models |= models
        title = f"In 3D: {run.name} at t = {at:.3f} s, {ghost.name} as a ghost"
        return Part(title, view={"runs": [run.name, ghost.name], "at": at})

    @property
    def elements(self) -> str:
        """The elements with the runs, as HTML; "" if there are none."""
        return data_elements(self._documents, self._models)


def limited(run: Shown, columns: Iterable[str]) -> Shown:
    """Leave out most signals, so that a page of many runs stays small."""
    return replace(run, only=frozenset((*KEPT, *columns)), notes=(*run.notes, LIMITED))
