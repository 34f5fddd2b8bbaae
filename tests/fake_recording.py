"""A recording in memory, with what summaries, pictures and pages need of one."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
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
    path: Path = Path("nowhere")
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


HOME = (0, 0, 0, -1.57079, 0, 1.57079, -0.7853, 0.04, 0.04, 0.4, -0.2, 0.05, 1, 0, 0, 0)


def made_up_run(rows: int = 1001) -> FakeRecording:
    """Return a run of the task: joint 1 turns, and the block is lifted between 30 and 80 %."""
    time = np.arange(rows) * 0.001
    share = np.linspace(0.0, 1.0, rows)
    held = (share >= 0.3) & (share < 0.8)
    qpos = np.tile(HOME, (rows, 1)).astype(float)
    qpos[:, 0] = share
    qpos[:, 11] += np.where(held, 0.2 * (share - 0.3), 0.0)
    place = 0.5 + 0.1 * np.sin(time)[:, None] * np.ones(3)
    signals = {
        "plant.qpos": qpos,
        "plant.qvel": np.zeros((rows, 15)),
        "plant.hand_xpos": place,
        "plant.actuator_force": np.zeros((rows, 8)),
        "plant.contact_force": np.where((share >= 0.315) & (share < 0.83), 20.0, 0.0),
        "controller.pos_cmd": place.copy(),
        "controller.qvel_ref": np.zeros((rows, 7)),
        "controller.grip_cmd": np.where(held, 0.0, 0.08),
    }
    return FakeRecording(time, signals)
