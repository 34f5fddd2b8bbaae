"""The master's step in C, many ticks in one call: the fast twin of `Step.take`.

The library (fmus/native/stepper.c) goes through a list of calls, which is read from what `Step`
would call, in its order, so that both give the same bits. It is for systems whose FMUs are called
in this process, without event mode, and exchange Real variables alone; for others, and where the
library is missing, `Step.take` is called.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from ..build.libraries import STEPPER, library
from ..build.platforms import this_platform
from ..errors import CosimError, InputError
from ..twins import changed
from .calls import OK, WARNING, Access, Caller
from .step import Step
from .wiring import Array, Moved, Shared, nothing

SLICE: Final = 0.005  # [s] wall time after which C returns, so that Python sees signals
SET_INPUTS, STEP, GET_OUTPUTS, COMPLETE, FEED_BACK = range(5)
ENDED, EARLY, NOT_FINITE, EVENT, LATE, GONE, TOLD = range(100, 107)
STEPPED: Final = 2


class _Call(ctypes.Structure):
    _fields_ = [
        ("action", ctypes.c_int32), ("fmi", ctypes.c_int32), ("later", ctypes.c_int64),
        ("function", ctypes.c_void_p), ("instance", ctypes.c_void_p),
        ("references", ctypes.c_void_p), ("count", ctypes.c_size_t), ("column", ctypes.c_size_t),
        ("values", ctypes.c_void_p), ("size", ctypes.c_size_t),
        ("columns", ctypes.c_void_p), ("places", ctypes.c_void_p), ("moved", ctypes.c_size_t),
        ("linear", ctypes.c_void_p), ("seconds", ctypes.c_double),
    ]  # fmt: skip


class _Course(ctypes.Structure):
    _fields_ = [
        ("calls", ctypes.c_void_p), ("call_count", ctypes.c_int64),
        ("rows", ctypes.c_void_p), ("width", ctypes.c_size_t),
        ("start", ctypes.c_double), ("step_size", ctypes.c_double), ("stop", ctypes.c_void_p),
        ("filled", ctypes.c_int64), ("failed", ctypes.c_int64), ("status", ctypes.c_int32),
        ("reached", ctypes.c_double), ("ended", ctypes.c_int64), ("timed", ctypes.c_int64),
    ]  # fmt: skip


class _NotInCError(Exception):
    """A call can only be made from Python."""


@cache
def load_stepper() -> Any:
    """Load the library; None: it lacks and so does a compiler, or `Step.take` is not its twin."""
    if changed("kernel"):
        return None
    try:
        stepper = ctypes.CDLL(str(library(STEPPER, this_platform())))
    except (CosimError, InputError, OSError):
        return None
    stepper.panda_take_steps.restype = ctypes.c_int64
    return stepper


def make_kernel(step: Step, rows: Array, *others: Any) -> Kernel | None:
    """Make the kernel of a step, if all of it can be called from C; see `Kernel`."""
    if rows.dtype != np.float64 or type(step) is not Step or load_stepper() is None:
        return None
    try:
        return Kernel(step, rows, *others)
    except _NotInCError:
        return None


class Kernel:
    """Takes the steps of a `Step` in C, many in one call.

    `make_kernel` makes it, or returns None where a call can only be made from Python. `checked` are
    the columns whose values must be finite before followers read a row.
    """

    def __init__(
        self,
        step: Step,
        rows: Array,
        start: float,
        stop: ctypes.c_int32,
        checked: Sequence[int] = (),
    ) -> None:
        self._step, self._rows = step, rows
        self._keep: list[object] = [stop]
        self._made_by: list[Any] = []  # `Access`, `Shared`, `StepCall` or None, of each call
        self._list: list[_Call] = []
        self._remote: list[Any] = []  # steps of FMUs in processes of their own
        for leader in step.leaders:
            self._exchange(SET_INPUTS, leader.set_inputs)
            self._step_once(leader.step)
            self._exchange(GET_OUTPUTS, leader.get_outputs)
        self._add(COMPLETE, None, **self._columns(checked))
        for follower in step.followers:
            self._exchange(SET_INPUTS, follower.set_inputs)
        for follower in step.followers:
            self._step_once(follower.step)
        for follower in step.followers:
            self._exchange(GET_OUTPUTS, follower.get_outputs, later=1)
        if step.fed_back:
            self._add(FEED_BACK, None, **self._columns(step.fed_back))
        self._calls = (_Call * len(self._list))(*self._list)
        self._course = _Course(
            ctypes.addressof(self._calls), len(self._calls), rows.ctypes.data, rows.shape[1],
            start, step.size, ctypes.addressof(stop),
        )  # fmt: skip
        for call in filter(None, self._made_by):  # a call of a tick, for the messages in it
            if isinstance(call.slave, Caller):
                call.slave.log.in_c = lambda: (
                    self._course.start,  # of each step, where it is asked for
                    self._course.filled,
                    self._course.failed,
                )

    def take(self, tick: int, row: int, count: int, *, timed: bool = False) -> tuple[int, int]:
        """Take up to `count` steps; returns how many were, and the number of complete rows.

        If they are timed, `account` knows how long each call took.
        """
        self._course.filled, self._course.timed = row, timed
        taken = load_stepper().panda_take_steps(
            ctypes.byref(self._course), *map(ctypes.c_int64, (tick, row, count)),
            ctypes.c_double(SLICE),
        )  # fmt: skip
        return taken, self._course.filled

    def serve(self, order: Array) -> int:
        """Take the steps that another process asks for, until it asks to listen: 0.

        Also until a step still needs an answer: 1, it has failed; `STEPPED`, it has not.
        """
        where = ctypes.c_void_p(order.ctypes.data)
        return int(load_stepper().panda_serve_steps(ctypes.byref(self._course), where))

    def account(self) -> None:
        """Add the time of the calls so far to `spent` of their FMUs, once."""
        for call, caller in zip(self._calls, self._made_by, strict=True):
            if caller is not None:
                caller.slave.spent[caller.name] += call.seconds
                call.seconds = 0.0

    def check(self, time: float) -> None:
        """Raise the error of the call that ended `take`, in the tick of a time, if one did."""
        course = self._course
        status, reached = course.status, course.reached
        if status == NOT_FINITE:
            self._step.complete(course.filled)  # which says what it is
        for caller in self._remote:
            caller.hear()
        if course.ended:
            ender = self._made_by[course.ended - 1]
            self._step.ended = ender.ending(time - self._step.size, reached)
        if OK <= status <= WARNING:
            return
        caller = self._made_by[course.failed]
        if status == ENDED:
            raise caller.ending(time, reached)
        if status == EARLY:
            caller.refuse_early(time, reached)
        elif status == EVENT:
            caller.meet_event(time)
        else:
            caller.fail(status, time)

    def _add(self, action: int, caller: Any, **fields: int | None) -> None:
        fields |= {} if caller is None else caller.for_c()
        self._made_by.append(caller)
        self._list.append(_Call(action, **fields))

    def _step_once(self, call: Any) -> None:
        if not getattr(call, "in_c", False):
            raise _NotInCError
        self._add(STEP, call, later=int(not call.slave.no_going_back))  # whether it is returned to
        self._remote += [call] if hasattr(call, "hear") else []

    def _exchange(self, action: int, exchange: object, later: int = 0) -> None:
        if exchange is nothing:
            return
        columns = places = None
        moves: dict[str, int | None] = {}
        while isinstance(exchange, Moved):  # to a slave's own order, perhaps, after the first
            if exchange.linear is not None:
                moves["linear"] = exchange.linear.ctypes.data
            if columns is None:
                columns = self._place(exchange.rows)[exchange.columns]
            places, exchange = exchange.places, exchange.call
        if not isinstance(exchange, Access | Shared) or exchange.memory.dtype != np.float64:
            raise _NotInCError
        if columns is None:
            moves["column"] = int(self._place(exchange.memory)[0])
        else:
            moves |= {"values": exchange.memory.ctypes.data, **self._columns(columns, places)}
        self._add(action, exchange, later=later, **moves, size=exchange.memory.shape[-1])

    def _place(self, block: Array) -> Any:
        """Columns of the rows that a block of theirs shows."""
        first = (block.ctypes.data - self._rows.ctypes.data) // self._rows.itemsize
        return np.arange(first, first + block.shape[1])

    def _columns(self, columns: Any, places: Any = ()) -> dict[str, int | None]:
        arrays = [np.array(values, np.uint32) for values in (columns, places)]
        self._keep += arrays
        where, places = (array.ctypes.data for array in arrays)
        return {"columns": where, "places": places, "moved": len(arrays[0])}
