"""Sources of the rows to be run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from .design import Design
from .row import Done, Task


class TaskSource(Protocol):
    """Gives tasks, and takes their results."""

    def __iter__(self) -> Iterator[Task]:
        """Yield the tasks."""

    def tell(self, done: Done) -> None:
        """Take the result of a row."""


class DesignSource:
    """Gives the missing rows of a design."""

    def __init__(self, design: Design, there: set[int]) -> None:
        self._design, self._there = design, there

    def __iter__(self) -> Iterator[Task]:
        """Yield the tasks by index."""
        for index in range(len(self._design)):
            if index not in self._there:
                yield Task(index, self._design.scenario(index), self._design.values(index))

    def tell(self, done: Done) -> None:
        """Do nothing: a design does not depend on results."""
