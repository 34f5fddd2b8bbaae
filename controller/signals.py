"""The signals of the control law, and where each is in memory.

What is multiplied by one matrix stands side by side: so a law of some thirty small sums takes two
products, see `controller.matrices`.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Layout = np.dtype[np.void]

# What the controller takes and gives; the fields' order is that of the flat buffers.
INPUTS = np.dtype(
    [
        ("pos_cmd", float, 3),
        ("quat_cmd", float, 4),
        ("vel_cmd", float, 3),
        ("omega_cmd", float, 3),
        ("grip_cmd", float),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("jac", float, (6, 7)),
        ("qpos", float, 7),
        ("qvel", float, 7),
        ("qfrc_bias", float, 7),
    ]
)
OUTPUTS = np.dtype(
    [
        ("ctrl", float, 8),
        ("dq", float, 7),
        ("qpos_ref", float, 7),
        ("qvel_ref", float, 7),
        ("manipulability", float),
        ("singular", float),
        ("limit", float, 7),
    ]
)
POSES = ("pos_cmd", "quat_cmd", "vel_cmd", "omega_cmd", "grip_cmd", "hand_xpos", "hand_xquat")
MEASURED = ("qpos", "qvel", "qfrc_bias")
SUMMED_OUTPUTS = ("ctrl", "dq", "qpos_ref", "qvel_ref")

# All that an update computes with besides its inputs: what it remembers of earlier ones, and what
# it makes on its way.
SIGNALS = np.dtype(
    [
        ("law", float),
        ("opening", float),
        ("pid", float, (3, 7)),
        ("weakest", float, 6),
        ("until_weighing", float),
        ("weighed_qpos", float, 7),
        # From here on what wishes are made of: copies of the inputs POSES among it ...
        ("one", float),
        ("twist_before", float, 6),
        ("rotation", float, 3),
        *((name, float, INPUTS[name].shape) for name in POSES),
        # ... and from here on what sums are made of, too ...
        ("qvel_before", float, 7),
        ("qpos_ref", float, 7),
        # ... from here on sums alone, with copies of the inputs MEASURED.
        ("gripper", float),
        *((name, float, 7) for name in MEASURED),
        ("motion", float, 7),
        # These are wished.
        ("drift", float, 7),
        ("error", float, 6),
        ("twist", float, 6),
    ]
)


def _from_to(first: str, last: str) -> tuple[str, ...]:
    """Names of neighbours among the signals."""
    names = cast("tuple[str, ...]", SIGNALS.names)
    return names[names.index(first) : names.index(last) + 1]


OF_WISHES: Final = _from_to("one", "qpos_ref")
WISHES: Final = _from_to("drift", "twist")
OF_SUMS: Final = _from_to("qvel_before", "error")
MOVES: Final = ("motion", "drift")  # their sum is the velocity of the joint reference
# What is summed up: the first outputs, the reference of the next update, and how near to its bound
# each of the things is that seldom come near one: beyond 1, a closer look is due. `reach_share`
# stands before `ctrl`, as inertia makes both.
SUMS = np.dtype(
    [
        ("change_share", float, 7),
        ("error_share", float, 6),
        ("reach_share", float, 7),
        *((name, float, OUTPUTS[name].shape) for name in SUMMED_OUTPUTS),
        ("qpos_next", float, 7),
        ("lag_share", float, 7),
        ("speed_share", float, 7),
    ]
)
SHARES: Final = (("change_share", "error_share", "reach_share"), ("lag_share", "speed_share"))


class Memory:
    """Numbers in one flat array, by the names of a layout.

    Args:
        layout: Fields of 64-bit floats.
        values: The array (n,); None: a new one, of zeros.

    Attributes:
        values: The array.
        fields: Its view by names, which also sets them.

    Raises:
        ValueError: The array is of another size.
    """

    def __init__(self, layout: Layout, values: Vector | None = None) -> None:
        size = layout.itemsize // 8
        self.values = np.zeros(size) if values is None else values
        if self.values.shape != (size,):
            raise ValueError(f"buffer of shape {self.values.shape}; must be ({size},)")
        self.fields: Any = self.values.view(layout)[0]
        self._places = places(layout)

    def __getitem__(self, name: str) -> Vector:
        """View of one field, in its shape."""
        view: Vector = self.fields[name]
        return view

    def part(self, *names: str) -> Vector:
        """View of neighbouring fields, flat."""
        return self.values[self._places[names[0]].start : self._places[names[-1]].stop]

    def scalars(self, *names: str) -> memoryview[float]:
        """View of neighbours as memory, of which single numbers are read and set far sooner."""
        return cast("memoryview[float]", self.part(*names).data)


class Buffers(NamedTuple):
    """All that a law computes with: layouts `INPUTS`, `OUTPUTS` and `SIGNALS`."""

    inputs: Memory
    outputs: Memory
    signals: Memory


def places(layout: Layout) -> dict[str, slice]:
    """Where each field of a layout is in its flat array."""
    assert layout.fields is not None
    starts = {name: field[1] // 8 for name, field in layout.fields.items()}
    return {
        name: slice(start, start + layout[name].itemsize // 8) for name, start in starts.items()
    }


def some(names: tuple[str, ...]) -> Layout:
    """Layout of some of the signals, side by side."""
    return np.dtype([(name, SIGNALS[name]) for name in names])
