"""Runs a scenario: what was prepared is opened, stepped, judged and written."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..fmus.errors import CosimError, InputError, SimulationError
from ..fmus.master.master import Master, RealtimePacer
from ..result.judging.summary import Summary
from ..result.judging.verdict import Verdict
from ..result.judging.verdicts import ENDED, FAILED, STOPPED, TIMEOUT
from ..task.scenario import Scenario, load_scenario
from ..task.typed import typed
from ..task.values import Values
from .exits import exit_guard
from .finished import Run
from .folder import claimed_folder
from .inputs import Inputs
from .journal import Action, Adjustments, End
from .options import Options
from .output import Output
from .prepare import Prepared, prepare
from .running_client import RunningClient, addressed
from .stopping import StopRequest, stopping_on_signals

Progress = Callable[[int, int], None]  # completed and total steps
NOT_OPEN = "session: is not open; `open` opens it"


@typed
def run_scenario(  # noqa: PLR0913 - what to run, how, and who is told
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    options: Options | None = None,
    *,
    values: Values | None = None,
    controller: str | type | None = None,
    progress: Callable[[int, int], None] | None = None,
    stop: threading.Event | None = None,
) -> Run:
    """Run a scenario and keep the results in a folder.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it.
        values: Values to change, by key: see `Scenario.changed`.
        controller: A law instead of the scenario's, as the key `fmus.controller`: the class itself
            (also of a script or a notebook), "FILE.py:CLASS", or an .fmu file.
        progress: Called with the completed and the total steps, a few times a second.
        stop: Set in another thread, it stops the run after the step under way.

    Returns:
        The run.

    Raises:
        InputError: Something given cannot be used; nothing is written then.
        SimulationError: An FMU failed; what was recorded is kept, marked incomplete.
    """
    loaded = load_scenario(scenario)  # read
    law: Values = {} if controller is None else {"fmus.controller": controller}
    changed = loaded.changed({**(values or {}), **law})  # change
    prepared = prepare(changed, options)  # prepare
    with stopping_on_signals(stop) as request, Execution(prepared, out) as execution:
        execution.advance(stop=request, progress=progress)  # step
        execution.judge(stop=request)  # judge
        return execution.close(stop=request)  # write


class Execution:
    """One run of what was prepared; a context manager, which opens and ends it.

    `run_scenario` makes one, and so does all that runs: `Session` is one that its caller steps.
    Without `writes` there is no folder, and all stays in memory, as for rows of sweeps. To run a
    scenario once, from its beginning to its end, `run_scenario` is enough.
    """

    def __init__(
        self,
        prepared: Prepared,
        out: Path | str | None = None,
        *,
        writes: bool = True,
        journals: bool = False,
    ) -> None:
        self.prepared, self.scenario = prepared, prepared.scenario
        self.folder = Path()
        self._out = None if out is None else Path(out)
        self._writes, self._journals = writes, journals
        self._stack: ExitStack | None = None  # of what an open run has to close
        self._output: Output | None = None
        self._reset()

    def _reset(self) -> None:
        self._adjustments = Adjustments(self.prepared)
        self.actions: list[Action] = []
        self.warnings: list[str] = self.prepared.notes
        self.failure = ""
        self._client: RunningClient | None = None
        self._summary: Summary | None = None  # of a failed run only if its recording can be read

    def open(self) -> Self:
        """Open the FMUs and the run's folder, at t = 0.

        Raises:
            InputError: A file or a value cannot be used.
            SimulationError: An FMU fails.
        """
        if self._stack is not None:
            raise InputError("session: is already open; `close` or `restart` ends its run")
        if is_another := self._output is not None:  # of a run before
            self._reset()
        with self._warnings_told(), ExitStack() as stack:
            prepared = stack.enter_context(addressed(self.prepared))
            if self._writes:
                folder = claimed_folder(self._out, self.scenario.name, is_another=is_another)
                self.folder = stack.enter_context(folder)
            with exit_guard(self.folder):
                system = stack.enter_context(prepared.open(self.warnings))
                self._output = Output(
                    prepared, system, self.folder, writes=self._writes, journals=self._journals
                )
                stack.enter_context(self._output.recorder)
                self._output.begin()
                with self._guarded():
                    system.master.begin(self._output.recorder.append)
                if prepared.listening:  # a program gives up soon if it waits for an import here
                    import_module("pyarrow.parquet")
                if self.scenario.client:
                    self._client = RunningClient(prepared, tells=self._writes)
                    stack.callback(self._client.end)
            self._stack = stack.pop_all()
        return self

    def judge(self, reason: str | None = None, *, stop: StopRequest | None = None) -> None:
        """Record the last row and judge the recording; see `close`, which does it otherwise."""
        stop = stop or StopRequest()
        if not (self.failure or self._summary):  # else it has been judged
            with self._guarded():
                self._end(reason or stop.text)
                self._summary = self._begun.judge(_end_by(stop))

    def close(
        self,
        reason: str | None = None,
        *,
        stop: StopRequest | None = None,
        meanwhile: Callable[[Run], None] | None = None,
    ) -> Run:
        """End the run: complete and judge the recording, free the FMUs.

        Args:
            reason: Why it ends before the scenario does, for the recording.
            stop: What may have stopped it.
            meanwhile: Called with the judged run while the recording's file is being written.

        Raises:
            SimulationError: The last row is not finite, or the disk is full.
        """
        if self._stack is None:
            raise InputError(NOT_OPEN)
        with self._stack:
            self._stack = None
            self.judge(reason, stop=stop)
            if self._summary is None:
                raise SimulationError(self.failure)
            warnings, recording = tuple(self.warnings), self._begun.in_memory
            signal = stop.signal if stop else 0
            run = Run(self.folder, self._summary, signal, warnings, recording)
            if meanwhile is not None:
                meanwhile(run)
        return run

    def _end(self, reason: str | None) -> None:
        """Record the last row and the end; an FMU may have ended the simulation."""
        ended, left = str(self._master.ended or ""), reason is None and self._has_left
        self._note(Action(self.tick, End(reason=reason or "")))
        self._master.end(self._adjustments.inputs[self.tick : self.tick + 1])
        self._begun.count_warnings()
        finished = self.tick == self.ticks
        if finished and not left:
            self.warnings += filter(None, [ended, self._client.unfinished if self._client else ""])
        default = ended or f"the session was ended at t = {self.time:.3f} s"
        self._close_recording(None if finished or left else reason or default)

    @property
    def _has_left(self) -> bool:
        """Whether the client, or a program that an FMU listens to, has ended the run by leaving."""
        if ended := self._master.ended:
            return ended.instance in self.prepared.listening
        return self._client is not None and self._client.left

    def _close_recording(self, reason: str | None) -> None:
        """End the recording, for a reason if it is not complete."""
        recorder = self._begun.recorder
        recorder.late |= self._adjustments.inputs.guarded.happened()
        recorder.end(complete=reason is None, reason=reason)

    def __enter__(self) -> Self:
        """Open it."""
        return self.open()

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """End the run, unless it has ended."""
        if self._stack is None:
            return
        if error is None:
            self.close()
            return
        with suppress(CosimError):  # the error being raised says more
            name = type(error).__name__
            self.close(f"{name}: {error}" if str(error) else name)

    def advance(
        self,
        last: int | None = None,
        stop: StopRequest | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Step up to a tick, or until asked to stop, at the pace of the options."""
        self._check_open()
        last, stop = self.ticks if last is None else last, stop or StopRequest()
        master, tell = self._master, progress or (lambda _done, _total: None)

        def look(done: int) -> None:
            stop.poll()
            tell(done, self.ticks)

        pace = self._pace()
        stop.watch(master, self.prepared.options.time_limit)
        with self._guarded(stop):
            inputs = self._adjustments.inputs
            with self._client.beside(master, stop) if self._client else nullcontext():
                while self.tick < last and not master.stop_requested:
                    inputs.guarded.look(self.tick, self._value)
                    count = inputs.guarded.unwatched(self.tick, last)
                    master.step(count, inputs, pace=pace, progress=look)
                master.flush()
            if self._client and self._has_left and not stop.reason:
                self._client.check_end(self.time, master.ended)
        tell(self.tick, self.ticks)

    def _pace(self) -> Callable[[int], None] | None:
        options, waits = self.prepared.options, bool(self.prepared.listening)
        if not options.realtime:
            return None
        period = self.scenario.step / options.realtime
        # A program that it waits for takes its time.
        return RealtimePacer(period, self._master.statistics, catches_up=not waits).wait

    def _value(self, signal: str) -> NDArray[np.float64]:
        """Present value of a signal of several elements, row by row (n,)."""
        return np.asarray(self._master.latest()[self._begun.columns[signal]], float)

    @property
    def inputs(self) -> Inputs:
        """External inputs of each tick, with the rows that have ended early."""
        return self._adjustments.inputs

    @property
    def tick(self) -> int:
        """Completed steps."""
        return self._master.steps

    @property
    def is_over(self) -> bool:
        """Whether no step is left, or an FMU has ended the simulation."""
        return self.tick >= self.ticks or self._master.ended is not None

    @property
    def ticks(self) -> int:
        """Steps from t = 0 to the scenario's end."""
        return self.scenario.ticks

    @property
    def time(self) -> float:
        """Current time [s]."""
        return self._master.time

    @property
    def _master(self) -> Master:
        return self._begun.system.master

    @property
    def _begun(self) -> Output:
        """The output of the run; that of one that has ended is still there."""
        if self._output is None:
            raise InputError(NOT_OPEN)
        return self._output

    def _check_open(self) -> None:
        if self._stack is None:
            raise InputError(NOT_OPEN)
        if self.failure or self._summary:
            how = "failed" if self.failure else "been judged"
            raise InputError(f"session: its run has {how}; `restart` begins another")

    @contextmanager
    def _guarded(self, stop: StopRequest | None = None) -> Iterator[None]:
        """Call into FMUs: if one fails, the run is over; if one calls exit(), it is a failure.

        An FMU whose client was killed, since the run is to `stop`, may fail.
        """
        try:
            with exit_guard(self.folder), self._warnings_told():
                yield
        except CosimError as error:
            stopped = stop.text if stop and self._client else None
            self.failure = "" if stopped else str(error)
            with suppress(CosimError):  # the failure itself says more
                self._close_recording(stopped or f"{type(error).__name__}: {error}")
                self._summary = self._begun.judge(_end_by(stop) if stop and stopped else FAILED)
            if not stopped:
                raise

    @contextmanager
    def _warnings_told(self) -> Iterator[None]:
        """Add the warnings so far to an error, as its notes."""
        try:
            yield
        except CosimError as error:
            for warning in dict.fromkeys(self.warnings):
                error.add_note(warning)
            raise

    def _note(self, action: Action) -> None:
        self.actions.append(action)
        self._begun.note(action)


def _end_by(stop: StopRequest) -> Verdict:
    """What an incomplete run comes to, if this may have stopped it."""
    return STOPPED if stop.signal else TIMEOUT if stop.is_late else ENDED
