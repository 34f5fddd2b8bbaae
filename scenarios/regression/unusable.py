"""A scenario's folder that cannot be used: it alone fails, the rest of the suite runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Unusable:
    """Stands for a scenario that cannot be read.

    Attributes:
        folder: The folder.
        error: The problem in one line.
    """

    folder: Path
    error: str
    purpose: str = ""

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name


__all__ = ["Unusable"]
