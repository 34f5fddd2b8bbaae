"""The control loops of a scenario at an instant of its run: margins, models, a picture."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...fmus.errors import InputError
from ...result.judging.signals import time_of
from ...run.execution import Execution
from ...run.finished import html
from ...run.inputs import Inputs
from ...run.options import Options
from ...run.prepare import Prepared, prepare
from ...task.criteria import check_instant, check_within
from ...task.scenario import Scenario, load_scenario
from ...task.typed import typed
from .confirm import Confirmation, confirm
from .margins import Measured, judge
from .responses import DECAYED, LINEAR, opened
from .state_space import COLUMNS, FIT, ROWS, realised, system

if TYPE_CHECKING:
    import control

    from ...result.pictures.canvas import ShownFigure


@dataclass(frozen=True, eq=False)
class Analysis(Measured):
    """The control loops of a scenario at an instant of its run, measured with its FMUs.

    Attributes:
        scenario: Name of the scenario.
        at: The instant [s].
        inputs: Where the n loops are opened, such as `plant.ctrl[1]` (n,).
        positions: Positions of the joints that these inputs move (n,), or () if the plant has none.
        period: Time between two updates of the controller, at which the models are sampled [s].
        margins: Margins of each loop and of all at once; see `Margins`.
        responses: What was measured, n loops; see `Responses`.
        confirmed: What runs on both sides of each margin came to, if they were verified.
    """

    confirmed: tuple[Confirmation, ...] = ()

    def plot(self, **others: Analysis) -> ShownFigure:
        """Return the figure of the loops, in a notebook or for a file, with others overlaid.

        analysis.plot(stiff=analyze(scenario.changed({"controller.kp": 16}))).savefig("a.pdf")
        """
        from .plot import draw_analyses  # noqa: PLC0415 - matplotlib takes its time

        return draw_analyses({self.scenario: self, **others})

    def _repr_html_(self) -> str:
        about = f"{self.scenario} at t = {self.at:g} s; loops opened at {', '.join(self.inputs)}"
        return html([about]) + self.margins._repr_html_() + html(self.remarks)

    @cached_property
    def plant(self) -> control.StateSpace:
        """`control.StateSpace` of the plant alone, from the loops' inputs to its outputs.

        Inputs (n): servo targets (rad) or torques (N.m). Outputs: `positions`, the joints' speeds,
        the hand's position and quaternion, all as differences to what they are without a pulse.
        States are those positions and speeds, such as `plant_qpos[1]`; what the responses need
        beside them is named `identified[1]` and so on: hidden states, or a plant that moves.
        Signals have `_` for the point in their names.
        """
        is_, names = self.responses, (self.inputs, self.responses.outputs, "plant")
        return realised(is_.of_plant(ROWS + COLUMNS + 1), is_.states, self.period, *names)[0]

    @property
    def closed(self) -> control.StateSpace:
        """`control.StateSpace` of the closed loops.

        Inputs (n): what is added to `inputs`. Outputs: `inputs` (n) with what is added, then those
        of `plant`. States: those of the plant as far as they are physical; those of the laws are
        identified.
        """
        return self._closed[0]

    @property
    def model(self) -> control.StateSpace:
        """The closed loops with the outputs `inputs` and `positions` alone."""
        return self._part(len(self.inputs) + len(self.positions), "model")

    @property
    def model_error(self) -> float:
        """Largest difference of `closed`'s response to a pulse, as a share of its peak."""
        return self._closed[1]

    @property
    def sensitivity(self) -> control.StateSpace:
        """S = 1 / (1 + L) as a `control.StateSpace` of n inputs and n outputs."""
        return self._part(len(self.inputs), "sensitivity")

    @property
    def loop(self) -> control.StateSpace:
        """The open loops L as a `control.StateSpace`: from `inputs` to what feeds them, negated.

        It has the states of `closed`.
        """
        closed, n = self.closed, len(self.inputs)
        b, c = closed.B, closed.C[:n]
        ends = self.inputs, self.inputs, "loop", closed.state_labels
        return system(closed.A - b @ c, b, -c, np.zeros((n, n)), self.period, *ends)

    def _part(self, outputs: int, name: str) -> Any:
        """Return the closed loops with their first outputs alone."""
        import control  # noqa: PLC0415 - brings matplotlib and scipy

        closed = self.closed
        return control.ss(closed[:outputs, :], name=name, states=closed.state_labels)

    @property
    def matrices(self) -> dict[str, Any]:
        """A, B, C and D of `model`, the names of its inputs and outputs, and its period [s]."""
        names = {"inputs": self.inputs, "outputs": (*self.inputs, *self.positions)}
        return {n: getattr(self.model, n) for n in "ABCD"} | names | {"period": self.period}

    @property
    def remarks(self) -> list[str]:
        """What makes the numbers less certain: one sentence each."""
        is_, window = self.responses, f"the {self.responses.window:g} s that were measured"
        texts = {
            f"{is_.remaining:.1%} of the responses is left after {window}": is_.remaining > DECAYED,
            f"a doubled pulse gives a response that is off by {is_.linearity:.1%}":
                is_.linearity > LINEAR,
            f"the state-space model's response differs by up to {self.model_error:.1%} of its peak":
                self.model_error > 10 * FIT,
        }  # fmt: skip
        return [text for text, holds in texts.items() if holds]

    @cached_property
    def _closed(self) -> tuple[Any, float]:
        is_, n = self.responses, len(self.inputs)
        pulses = is_.pulses.copy()
        pulses[0, :n] += np.eye(n)  # what is added, itself
        names = self.inputs, (*self.inputs, *is_.outputs), "closed"
        return realised(pulses, [n + i for i in is_.states], self.period, *names)


@typed
def analyze(
    scenario: Scenario | str | Path,
    at: float | str = "start",
    options: Options | None = None,
    *,
    loop: str = "",
    verify: bool = False,
) -> Analysis:
    """Measure the control loops of any scenario at an instant of its run.

    Small pulses are added to each input of the plant that is controlled, one after the other, and
    the FMUs go back to the same state before each. Commands and pushes continue as in the run;
    responses are differences from it. The margins are those of the loops at that instant, if the
    responses fall below 1 % before a contact or a limit changes them.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        at: Time [s], or an event of the run such as "grasp" or "release + 0.5".
        options: How it is run.
        loop: Input at which the loops are opened, such as "plant.ctrl"; "": all inputs of the
            instance `plant` that an FMU feeds.
        verify: Whether to run with changes just within and just beyond each margin.

    Returns:
        Margins and state-space models.

    Raises:
        InputError: Something given cannot be used, or an FMU cannot go back to a state.
        SimulationError: An FMU failed.
    """
    prepared = prepare(load_scenario(scenario), options)
    tick, inputs = _instant(prepared, at)
    with opened(prepared, inputs, tick, loop) as measurement:
        responses = measurement.responses()
        margins = judge(responses, prepared.scenario.coupling)
        wanted = verify and margins.stable
        confirmed = confirm(margins, responses.sensitivity, measurement.bears) if wanted else ()
    name, is_ = prepared.scenario.name, responses
    loops = is_.inputs, is_.positions, is_.period
    return Analysis(name, is_.at, *loops, margins, responses, confirmed)


def _instant(prepared: Prepared, at: float | str) -> tuple[int, Inputs]:
    """Tick of a time or an event, and the run's inputs.

    Where events, or rows that end early, depend on the run, it is run first, in memory.
    """
    start, scenario, inputs = prepared.assembly.start_time, prepared.scenario, prepared.inputs()
    span = start, start + scenario.duration
    with suppress(ValueError):
        at = float(at) if isinstance(at, str) else at
    try:
        instant = check_instant(at)
        time = check_within("at", instant, *span)
        if time is None or inputs.guarded.guards:
            with Execution(prepared, writes=False) as execution:
                execution.advance()
                inputs, events = execution.inputs, execution.close().summary.events
            time = check_within("at", time_of(instant, events), *span)
    except ValueError as error:
        raise InputError(f"at: {str(error).removeprefix('at: ')}") from None
    return round(((time or 0.0) - start) / scenario.step), inputs
