"""A recording in memory, with what summaries, pictures and pages need of one."""

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
    descriptions: dict[str, str] = field(default_factory=dict)
    addresses: dict[str, str] = field(default_factory=dict)
    complete: bool = True
    reason: None = None

    @property
    def columns(self) -> list[str]:
        """Names of all columns, such as `plant.qpos[1]`."""
        return [
            name + (f"[{','.join(str(i + 1) for i in index)}]" if index else "")
            for name, values in self.signals.items()
            for index in np.ndindex(*values.shape[1:])
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
        return name in self.signals or name.rpartition("[")[0] in self.signals

    def __getitem__(self, name: str) -> FloatArray:
        """Return a signal (n, ...), or one of its columns (n,)."""
        if name in self.signals:
            return self.signals[name]
        signal, _, element = name.rpartition("[")
        index = (int(i) - 1 for i in element[:-1].split(","))
        return self.signals[signal][(slice(None), *index)]
