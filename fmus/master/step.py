"""The master's step: from the values at t_k to those at t_k+1 = t_k + step size.

All values are in the rows of the recording: slaves set their inputs from row k, and write their
outputs to row k or k + 1. There is no other copy of them.

Gauss-Seidel: a slave that feeds a later one is a leader, such as the controller, which feeds the
plant. Its outputs act within the same step. The other slaves are followers.
Jacobi: there are no leaders, so all outputs act one step later.
Iterated: the step is repeated, with the outputs at its end as inputs, until these no longer change.

`Kernel` takes many ticks in one call, in C (fmus/native/stepper.c): the calls of `Step.take`, in
its order. It is for systems whose FMUs are called in this process and exchange Real variables
alone; for others, and where its library is missing, `Step.take` is called.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import chain
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..build.libraries import STEPPER, library, this_platform
from ..errors import CosimError, InputError, SimulationError
from .calls import Access, StepCall
from .wiring import BoundSlave, Moved, nothing

Coupling = Literal["gauss-seidel", "jacobi", "iterated"]
SWITCHED: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")  # also during a run
COUPLINGS: tuple[Coupling, ...] = (*SWITCHED, "iterated")
ITERATIONS: Final = ("coupling", "iterations")  # name of their column
MOST_ITERATIONS: Final = 100
TOLERANCE: Final = 1e-10  # change of an output by an iteration; relative, or absolute below 1


class Step:
    """One communication step of a coupled system."""

    fed_back: list[int]  # columns of outputs that a leader or an earlier one reads in the next step

    def __init__(
        self,
        slaves: Sequence[BoundSlave],  # in the order of stepping
        coupling: Coupling,
        size: float,  # [s]
        rows: NDArray[np.float64],  # (n, columns) that the slaves are bound to
        complete: Callable[[int], None],  # called with a row's index before followers read it
    ) -> None:
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.leaders = _leaders(slaves) if coupling == "gauss-seidel" else []
        self.followers = [slave for slave in slaves if slave not in self.leaders]
        for slave in slaves:
            slave.leads = slave in self.leaders
        self.leader_columns = _columns(self.leaders)
        self.fed_back = _columns(_feeding_back(self.leaders))
        self.size, self._rows, self._complete = size, rows, complete

    def take(self, row: int, time: float) -> None:
        """Step from `time` [s]; its row has the external inputs and the followers' outputs."""
        size, followers = self.size, self.followers
        self.lead(row, time)
        self._complete(row)
        for follower in followers:
            follower.set_inputs(row)
        for follower in followers:
            follower.step(time, size)
        for follower in followers:
            follower.get_outputs(row + 1)
        if self.fed_back:  # read by this or an earlier leader in the next step
            self._rows[row + 1, self.fed_back] = self._rows[row, self.fed_back]

    def lead(self, row: int, time: float) -> None:
        """Step the leaders from `time`, so that all values of its row are known."""
        for leader in self.leaders:
            leader.set_inputs(row)
            leader.step(time, self.size)
            leader.get_outputs(row)


class IteratedStep(Step):
    """A step that is repeated, by Aitken's method, until outputs and inputs at its end agree."""

    def __init__(
        self,
        slaves: Sequence[BoundSlave],
        coupling: Coupling,
        size: float,
        rows: NDArray[np.float64],
        complete: Callable[[int], None],
    ) -> None:
        super().__init__(slaves, coupling, size, rows, complete)
        fed = {column for slave in slaves for column in slave.inputs}
        outputs = _columns(slaves)
        self._fed, self._held = sorted(fed.intersection(outputs)), sorted(fed.difference(outputs))

    def take(self, row: int, time: float) -> None:
        """Step from `time` [s]."""
        self._complete(row)
        now, end = self._rows[row], self._rows[row + 1]
        numbers = [column for column in self._fed if not isinstance(now[column], str | bytes)]
        given, share, change = end[self._held].copy(), 1.0, np.zeros(len(numbers))
        end[self._held], end[self._fed] = now[self._held], now[self._fed]
        for slave in self.followers:
            slave.slave.save_state()
        for count in range(1, MOST_ITERATIONS + 1):
            guess, before = end[numbers].astype(np.float64), change
            self._iterate(row + 1, time)
            after = end[numbers].astype(np.float64)
            change = after - guess
            if (np.abs(change) <= TOLERANCE * np.maximum(1.0, np.abs(after))).all():
                end[self._held], end[-1] = given, count
                return
            difference = change - before
            if count > 1 and difference.any():
                share *= -float(before @ difference) / float(difference @ difference)
            end[numbers] = guess + share * change
            for slave in self.followers:
                slave.slave.restore_state()
        worst = numbers[int(np.argmax(np.nan_to_num(np.abs(change), nan=np.inf)))]
        slave = next(slave for slave in self.followers if worst in slave.outputs)
        raise SimulationError(
            f'coupling = "iterated": {MOST_ITERATIONS} iterations do not settle to a change of '
            f"{TOLERANCE:g}",
            time=time,
            instance=slave.slave.name,
            variable=slave.names[slave.outputs.index(worst)],
        )

    def _iterate(self, row: int, time: float) -> None:
        """Take the step with the inputs at its end."""
        for slave in self.followers:
            slave.set_inputs(row)
            slave.step(time, self.size)
            slave.get_outputs(row)


def _leaders(slaves: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Slaves that feed a later one."""
    return [
        slave
        for i, slave in enumerate(slaves)
        if any(slave.feeds(later) for later in slaves[i + 1 :])
    ]


def _feeding_back(leaders: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Leaders that feed themselves or an earlier leader."""
    return [
        leader
        for i, leader in enumerate(leaders)
        if any(leader.feeds(earlier) for earlier in leaders[: i + 1])
    ]


def _columns(slaves: Sequence[BoundSlave]) -> list[int]:
    return [column for slave in slaves for column in slave.outputs]


Array = NDArray[np.float64]
SLICE: Final = 0.005  # [s] wall time after which C returns, so that Python sees signals
SET_INPUTS, STEP, GET_OUTPUTS, COMPLETE, FEED_BACK = range(5)
WARNING, ENDED, EARLY, NOT_FINITE = 1, 100, 101, 102


class _Call(ctypes.Structure):
    _fields_ = [
        ("action", ctypes.c_int32), ("fmi", ctypes.c_int32), ("later", ctypes.c_int64),
        ("function", ctypes.c_void_p), ("instance", ctypes.c_void_p),
        ("references", ctypes.c_void_p), ("count", ctypes.c_size_t), ("column", ctypes.c_size_t),
        ("values", ctypes.c_void_p), ("size", ctypes.c_size_t),
        ("columns", ctypes.c_void_p), ("places", ctypes.c_void_p), ("moved", ctypes.c_size_t),
        ("linear", ctypes.c_void_p),
    ]  # fmt: skip


class _Course(ctypes.Structure):
    _fields_ = [
        ("calls", ctypes.c_void_p), ("call_count", ctypes.c_int64),
        ("rows", ctypes.c_void_p), ("width", ctypes.c_size_t),
        ("start", ctypes.c_double), ("step_size", ctypes.c_double), ("stop", ctypes.c_void_p),
        ("filled", ctypes.c_int64), ("failed", ctypes.c_int64), ("status", ctypes.c_uint32),
        ("reached", ctypes.c_double),
    ]  # fmt: skip


class _NotInCError(Exception):
    """A call can only be made from Python."""


@cache
def load_stepper() -> Any:
    """Load the library; None: it is missing, and there is no compiler."""
    try:
        stepper = ctypes.CDLL(str(library(STEPPER, this_platform())))
    except (CosimError, InputError, OSError):
        return None
    stepper.panda_take_steps.restype = ctypes.c_int64
    return stepper.panda_take_steps


def make_kernel(
    step: Step, rows: Array, start: float, stop: ctypes.c_int32, *, check: bool
) -> Kernel | None:
    """Make the kernel of a step, if all of it can be called from C; `check`: each row's values."""
    if rows.dtype != np.float64 or type(step) is not Step or load_stepper() is None:
        return None
    try:
        return Kernel(step, rows, start, stop, check=check)
    except _NotInCError:
        return None


class Kernel:
    """Takes steps in C; for the arguments see `make_kernel`."""

    def __init__(
        self, step: Step, rows: Array, start: float, stop: ctypes.c_int32, *, check: bool
    ) -> None:
        self._rows = rows
        self._keep: list[object] = [stop]
        self._made_by: list[Access | StepCall | None] = []
        leaders, followers = step.leaders, step.followers
        calls = [
            *chain.from_iterable(
                [
                    *self._access(SET_INPUTS, [leader.set_inputs]),
                    self._step(leader.step),
                    *self._access(GET_OUTPUTS, [leader.get_outputs]),
                ]
                for leader in leaders
            ),
            self._add(None, action=COMPLETE, count=int(check)),
            *self._access(SET_INPUTS, [follower.set_inputs for follower in followers]),
            *[self._step(follower.step) for follower in followers],
            *self._access(GET_OUTPUTS, [f.get_outputs for f in followers], later=1),
        ]
        if step.fed_back:
            calls.append(self._add(None, action=FEED_BACK, **self._columns(step.fed_back)))
        self._calls = (_Call * len(calls))(*calls)
        self._course = _Course(
            ctypes.addressof(self._calls), len(calls), rows.ctypes.data, rows.shape[1],
            start, step.size, ctypes.addressof(stop),
        )  # fmt: skip

    def take(self, tick: int, row: int, count: int) -> tuple[int, int]:
        """Take up to `count` steps; returns how many were, and the number of complete rows."""
        self._course.filled = row
        taken = load_stepper()(
            ctypes.byref(self._course), *map(ctypes.c_int64, (tick, row, count)),
            ctypes.c_double(SLICE),
        )  # fmt: skip
        return taken, self._course.filled

    @property
    def met_non_finite(self) -> bool:
        """Whether the last call of `take` ended at a row with a value that is not finite."""
        return bool(self._course.status == NOT_FINITE)

    def check(self, time: float) -> None:
        """Raise the error of the call that ended `take`, in the tick of a time, if one did."""
        status = self._course.status
        if status <= WARNING:
            return
        caller = self._made_by[self._course.failed]
        if isinstance(caller, StepCall) and status in (ENDED, EARLY):
            caller.refuse_early(time, self._course.reached, ended=status == ENDED)
        elif caller is not None:
            caller.fail(status, time)

    def _add(self, caller: Access | StepCall | None, **fields: int | None) -> _Call:
        self._made_by.append(caller)
        return _Call(**fields)

    def _step(self, call: object) -> _Call:
        if not isinstance(call, StepCall) or call.slave.fmu.in_python:
            raise _NotInCError
        is_returned_to = not call.slave.no_going_back.value
        return self._add(call, action=STEP, later=int(is_returned_to), **_callee(call))

    def _access(self, action: int, exchanges: Iterable[object], later: int = 0) -> list[_Call]:
        return [
            self._exchange(exchange, action=action, later=later)
            for exchange in exchanges
            if exchange is not nothing
        ]

    def _exchange(self, exchange: object, **fields: int) -> _Call:
        columns = places = None
        moves: dict[str, int | None] = {}
        while isinstance(exchange, Moved):  # to a slave's own order, perhaps, after the first
            if exchange.linear is not None:
                moves["linear"] = exchange.linear.ctypes.data
            if columns is None:
                columns = self._place(exchange.rows)[exchange.columns]
            places, exchange = exchange.places, exchange.call
        if not isinstance(exchange, Access) or exchange.block.dtype != np.float64:
            raise _NotInCError
        if columns is None:
            moves["column"] = int(self._place(exchange.block)[0])
        else:
            moves |= {"values": exchange.block.ctypes.data, **self._columns(columns, places)}
        references = exchange.references
        return self._add(
            exchange, **fields, **_callee(exchange), **moves, size=exchange.block.shape[1],
            references=references.ctypes.data, count=len(references),
        )  # fmt: skip

    def _place(self, block: Array) -> Any:
        """Columns of the rows that a block of theirs shows."""
        first = (block.ctypes.data - self._rows.ctypes.data) // self._rows.itemsize
        return np.arange(first, first + block.shape[1])

    def _columns(self, columns: Any, places: Any = ()) -> dict[str, int | None]:
        arrays = [np.array(values, np.uint32) for values in (columns, places)]
        self._keep += arrays
        where, places = (array.ctypes.data for array in arrays)
        return {"columns": where, "places": places, "moved": len(arrays[0])}


def _callee(call: Access | StepCall) -> dict[str, int | None]:
    function = ctypes.cast(call.function, ctypes.c_void_p).value
    return {"function": function, "instance": call.slave.component, "fmi": call.slave.fmu.fmi}
