"""A scenario's folder that cannot be used: it fails alone, and the others of its suite run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Unusable:
    """Stands for a scenario that cannot be read.

    Attributes:
        folder: Where it is.
        error: What is wrong with it, in one line.
    """

    folder: Path
    error: str
    purpose: str = ""

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name


__all__ = ["Unusable"]
