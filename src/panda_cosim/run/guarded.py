"""Rows of a table that end early, once the arm feels what the column `until` says."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assets import STEP_SIZE
from ..fmus.errors import InputError
from ..fmus.master.wiring import Array
from ..task.table import split_until
from ..task.trajectory import TIME_TOLERANCE, Trajectory

# Contact is measured against its mean over these ticks after the row's start, and is itself a mean
# over some ticks, so that neither starting nor noise ends a row. The player in C has them, too.
BASE: Final = (60, 160)
AVERAGED: Final = 10  # ticks
BRAKING: Final = 0.02  # [s] in which the hand stops
CONTACT: Final = ("plant.jac", "plant.actuator_force", "plant.qfrc_bias")  # what it is computed of
FORCE: Final = ("controller.external_force",)


class Guard(NamedTuple):
    """A row that may end early."""

    row: int  # its index
    first: int  # tick at which the hand leaves the row before
    last: int  # tick of the row's time
    element: int  # 0: contact; 1 to 6: of the external force; 7: its length
    bound: float  # [N] or [N.m]
    way: tuple[float, ...]  # direction of the hand (3,), world frame


def _guard(trajectory: Trajectory, row: int) -> Guard:
    place = f"row {row + 1}, column until"
    way = trajectory.positions[row] - trajectory.positions[max(row - 1, 0)]
    turns = (trajectory.orientations[row] != trajectory.orientations[max(row - 1, 0)]).any()
    if turns or not way.any():
        raise InputError(f"{place}: the hand must move towards it without turning")
    element, bound = split_until(trajectory.untils[row])
    ticks = np.ceil((trajectory.times[row - 1 : row + 1] - TIME_TOLERANCE) / STEP_SIZE)
    first, last = map(int, ticks)
    if element == 0 and last - first <= BASE[1]:
        raise InputError(f"{place}: contact is known {BASE[1]} ms after the row before; must come "
                         "later")  # fmt: skip
    return Guard(row, first, last, element, bound, tuple(way / np.linalg.norm(way)))


def returning(trajectory: Trajectory, row: int, times: Array) -> Array:
    """How much of an early end's offset is left after it (n, 2): its share, and the rate [1/s].

    Rows at the same place stay where the row has ended; on the way to the next one it goes to 0.
    """
    same = (trajectory.positions[row:] == trajectory.positions[row]).all(axis=1)
    moves = row + int(np.argmin(np.append(same, False)))  # the first row at another place
    begin = trajectory.times[moves - 1]
    end = trajectory.times[moves] if moves < len(trajectory.times) else np.inf
    u = np.clip((times - begin) / (end - begin), 0.0, 1.0)
    done, rate = trajectory.time_law(u, np.full(len(times), end - begin))
    within = (times + TIME_TOLERANCE >= trajectory.times[row]) & (times + TIME_TOLERANCE < end)
    return np.where(within[:, None], np.hstack((1.0 - done, -rate)), 0.0)


@lru_cache(maxsize=4)  # rows of a sweep often have one trajectory
def sampled(trajectory: Trajectory, first: int, count: int) -> Array:
    """Commands (count, 14) from a tick on, as the table gives them."""
    return trajectory.sample(STEP_SIZE * np.arange(first, first + count, dtype=np.float64))


def braking(elapsed: Array) -> tuple[Array, Array]:
    """Return what is left of the way of braking, in speed times time, and of the speed (n, 1).

    The speed falls as 1 - 3 u^2 + 2 u^3; `elapsed` is the time since the end of the row (n,) [s].
    """
    u = np.minimum(elapsed / BRAKING, 1.0)[:, None]
    cube = u * u * u
    return u - cube + 0.5 * cube * u - 0.5, 1.0 - 3.0 * u * u + 2.0 * cube


class Early(NamedTuple):
    """An early end of a row."""

    row: int
    tick: int
    ahead: int  # ticks by which the table is ahead from here on
    offset: Array  # of the hand from the row, once it has stopped (3,) [m]
    speed: Array  # of the hand when the row ends (3,) [m/s]


class GuardedCommands:
    """The commands of a trajectory, some rows of which end early."""

    def __init__(
        self, trajectory: Trajectory | None = None, before: GuardedCommands | None = None
    ) -> None:
        self.trajectory = trajectory  # None: a system has none
        untils = enumerate(trajectory.untils) if trajectory else ()
        self.guards = [_guard(self.path, row) for row, until in untils if until]  # in order
        self.ends: list[Early] = [*before.ends] if before else []
        self._felt: list[float] = [*before._felt] if before else []

    @property
    def path(self) -> Trajectory:
        """The trajectory of a scenario that is no system."""
        assert self.trajectory is not None
        return self.trajectory

    @property
    def signals(self) -> set[str]:
        """What is measured to end rows."""
        return set().union(*(FORCE if guard.element else CONTACT for guard in self.guards))

    def commands(self, first: int, count: int) -> Array:
        """Commands (count, 14) from a tick on."""
        since = [end for end in self.ends if end.tick > first]
        turns = [first, *(min(end.tick, first + count) for end in since), first + count]
        parts = [self._part(a, b - a) for a, b in pairwise(turns) if b > a]
        return parts[0] if len(parts) == 1 else np.vstack(parts)

    def _part(self, first: int, count: int) -> Array:
        """Commands between two early ends."""
        early = next((end for end in reversed(self.ends) if end.tick <= first), None)
        if early is None:
            return sampled(self.path, first, count)
        commands = sampled(self.path, first + early.ahead, count).copy()
        times = STEP_SIZE * (first + early.ahead + np.arange(count, dtype=np.float64))
        left = returning(self.path, early.row, times)
        commands[:, :3] += left[:, :1] * early.offset
        commands[:, 7:10] += left[:, 1:] * early.offset
        way, rate = braking(STEP_SIZE * (first - early.tick + np.arange(count, dtype=np.float64)))
        commands[:, :3] += way * (BRAKING * early.speed)
        commands[:, 7:10] += rate * early.speed
        return commands

    def packed(self, count: int) -> dict[str, Array]:
        """As the player in C reads it: the guards, and what is left of offsets in each row."""
        rows = [(g.first, g.last, g.element, g.bound, *g.way) for g in self.guards]
        times = STEP_SIZE * np.arange(count, dtype=np.float64)
        left = sum(returning(self.path, guard.row, times) for guard in self.guards)
        return {"guards": np.array(rows, float), "left": np.asarray(left)}

    def happened(self) -> dict[str, object]:
        """Metadata of a recording: when rows were reached, and which ended early; {}: none can."""
        if not self.guards:
            return {}
        untils, times = self.path.untils, self.path.times.copy()
        ended = {end.row: end.tick * STEP_SIZE for end in self.ends}
        for end in self.ends:
            times[end.row :] = self.path.times[end.row :] - end.ahead * STEP_SIZE
            times[end.row] = ended[end.row]
        rows = [
            {"row": row + 1, "until": untils[row], "ended_s": ended.get(row)}
            for row in (guard.row for guard in self.guards)
        ]
        return {"row_times": times.tolist(), "row_ends": rows}

    def ahead(self, tick: int) -> int:
        """Ticks by which the table is ahead at a tick."""
        return next((end.ahead for end in reversed(self.ends) if end.tick <= tick), 0)

    def places(self, ticks: NDArray[np.intp]) -> NDArray[np.intp]:
        """Ticks of the table that are played at ticks."""
        begun = np.searchsorted([end.tick for end in self.ends], ticks, side="right")
        return np.asarray(ticks + np.array([0, *(end.ahead for end in self.ends)])[begun])

    def unwatched(self, tick: int, last: int) -> int:
        """Number of ticks until the next one at which a row may end, or until a last one."""
        place = tick + self.ahead(tick)
        begins = [max(guard.first + 1 - place, 1) for guard in self.guards if place < guard.last]
        return min([last - tick, *begins])

    def look(self, tick: int, value: Callable[[str], Array]) -> None:
        """Let a row end by the values measured at a tick, before that is stepped."""
        place = tick + self.ahead(tick)
        guard = next((each for each in self.guards if each.first < place < each.last), None)
        if guard is None or self._measured(guard, place, value) <= guard.bound:
            return
        row, now = sampled(self.path, guard.last, 1)[0], self.commands(tick, 1)[0]
        speed = now[7:10]
        offset = now[:3] + 0.5 * (BRAKING * speed) - row[:3]
        self.ends.append(Early(guard.row, tick, guard.last - tick, offset, speed))

    def _measured(self, guard: Guard, place: int, value: Callable[[str], Array]) -> float:
        """What is compared with the bound [N] or [N.m]."""
        if guard.element:
            force = value(FORCE[0])
            part = force[:3] if guard.element == 7 else force[guard.element - 1 : guard.element]
            return float(np.linalg.norm(part))
        if place == guard.first + 1:
            self._felt.clear()
        # The force along the way that explains the servos' torques best.
        jac, torque, bias = map(value, CONTACT)
        lever = jac.reshape(6, 7)[:3].T @ guard.way
        torque = torque[:7] - bias
        self._felt.append(float(lever @ torque / (lever @ lever)))
        if len(self._felt) <= BASE[1]:
            return 0.0
        return float(np.mean(self._felt[-AVERAGED:]) - np.mean(self._felt[slice(*BASE)]))
