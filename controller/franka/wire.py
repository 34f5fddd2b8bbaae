"""The messages of Franka's control interface as numpy's structures: the tables of wire.toml.

Requests and their answers go over TCP, each behind a header; the robot's states, and the commands
of a motion, go over UDP.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Layout = np.dtype[np.void]
Message = Any  # a record: its fields by their names, `message["q"]`; None without fields
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ERRORS: Final[tuple[str, ...]] = tuple(_TABLES["errors"])


class ProgramError(ValueError):
    """A program has died, floods, or sends what is no message; or none has come."""


class Generator(IntEnum):
    """What a motion commands; a request counts from the second."""

    IDLE, JOINT_POSITION, JOINT_VELOCITY, CARTESIAN_POSE, CARTESIAN_VELOCITY, NONE = range(6)


class Control(IntEnum):
    """What makes torques of it."""

    JOINT_IMPEDANCE, CARTESIAN_IMPEDANCE, EXTERNAL, OTHER = range(4)


class Mode(IntEnum):
    """What the robot is doing."""

    OTHER, IDLE, MOVE, GUIDING, REFLEX, STOPPED, RECOVERY = range(7)


class Status(IntEnum):
    """In the answers to most requests."""

    SUCCESS, NOT_POSSIBLE, INVALID = range(3)


class MoveStatus(IntEnum):
    """In the two answers to `move`: that the motion starts, and how it has ended."""

    SUCCESS, STARTED, PREEMPTED = range(3)
    NOT_POSSIBLE, INVALID, REFLEX = 5, 7, 8


class GripperStatus(IntEnum):
    """In the gripper's answers."""

    SUCCESS, FAIL, UNSUCCESSFUL, ABORTED = range(4)


def layout(fields: Mapping[str, str]) -> Layout:
    """Return the structure of a table's fields."""
    return np.dtype([*fields.items()]).newbyteorder("<")


STATE, COMMAND, GRIPPER_STATE = (
    layout(_TABLES["packets"][name]) for name in ("state", "command", "gripper_state")
)


@dataclass(frozen=True)
class Protocol:
    """One of the two services: its version, and its requests in the order of their numbers."""

    name: str
    version: int
    status: str  # type of the status in an answer
    header: Layout
    requests: tuple[tuple[str, Layout], ...]

    def answer(self, number: int, identity: int, status: int, more: bytes = b"") -> bytes:
        """Make the answer to a request."""
        body = np.array(status, self.status).tobytes() + more
        size = self.header.itemsize + len(body)
        return np.array((number, identity, size), self.header).tobytes() + body

    def split(self, data: bytes) -> Iterator[tuple[int, int, int, Message]]:
        """Yield number, identity, size and fields of the complete requests that data begin with."""
        head = self.header.itemsize
        while len(data) >= head:
            number, identity, size = np.frombuffer(data, self.header, 1)[0].item()
            fields = self.requests[number][1] if number < len(self.requests) else None
            if fields is None or size != head + fields.itemsize:
                raise ProgramError(
                    f"the program sends request {number} of {size} bytes, which version "
                    f"{self.version} of the {self.name} does not have"
                )
            if len(data) < size:
                return
            message = np.frombuffer(data, fields, 1, head)[0] if fields.itemsize else None
            yield number, identity, size, message
            data = data[size:]


ROBOT, GRIPPER = (
    Protocol(name, each["version"], each["status"], layout(each["header"]),
             tuple((request, layout(fields)) for request, fields in each["requests"].items()))
    for name, each in _TABLES["services"].items()
)  # fmt: skip


def matrix(columns: Any) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of its columns (16,)."""
    return np.array(columns, float).reshape(4, 4).T


def columns(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the columns (16,) of a matrix (4, 4)."""
    return pose.T.reshape(-1)
