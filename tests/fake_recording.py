"""A recording in memory, with what pictures need of one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass
class FakeRecording:
    """Signals by name, each (n, ...)."""

    time: FloatArray
    signals: dict[str, FloatArray]
    metadata: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> list[str]:
        """Names of all columns, such as `plant.qpos[1]`."""
        vectors = {name: v.shape[1:] for name, v in self.signals.items()}
        return [
            name + (f"[{index[0] + 1}]" if index else "")
            for name, shape in vectors.items()
            for index in np.ndindex(*shape)
        ]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.time)

    def in_blocks(self, *names: str, before: int = 0) -> Iterator[list[FloatArray]]:
        """Yield signals in one block."""
        del before  # none are
        yield [self.time if name == "time" else self[name] for name in names]

    def __contains__(self, name: str) -> bool:
        """Whether there is such a signal, or a column of one."""
        return name.partition("[")[0] in self.signals

    def __getitem__(self, name: str) -> FloatArray:
        """Return a signal (n, ...), or one of its columns (n,)."""
        signal, _, element = name.partition("[")
        values = self.signals[signal]
        return values[:, int(element[:-1]) - 1] if element else values
