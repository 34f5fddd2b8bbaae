"""Success criteria of a scenario: [success], [[success.signal]] and [[success.body]].

A criterion is only data, which `judging` interprets; no code in it is run.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, PlainSerializer, PlainValidator

from ..fmus.errors import excerpt, located, refuse
from .fields import Choice, Line, Quantity, Vector, checked, field_names
from .table import POSITION

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
HELD_FORCE: Final = 0.5  # [N] finger force on the block above which it counts as held
LIFTED: Final = 0.005  # [m] way of the block since it is held from which it counts as carried
NEVER: Final = "so that it can never hold"
ALWAYS: Final = "so that it can never fail"
SLACK: Final = 1e-9  # [s] rounding of k * dt; less of a run that is shorter than a second
EVENTS: Final[Sequence[str]] = _TABLES["events"]
_OPERANDS: Final = {"norm": (1, 2), "difference": (2,)}  # how many signals each takes
_INSTANT = re.compile(
    r"(?P<event>\w+)(?: *(?P<sign>[+-]) *(?P<offset>\d{1,4}(?:\.\d{1,9})?))?", re.A
)
_TIME = Quantity(0.0, 3600.0, "s")
_ANY = Quantity()
BLOCK: Final = "obj"  # the body of PandaPlant's block
# Bounds of a body's criteria, with their units.
BOUNDS: Final = {"tolerance": "m", "max_tilt": "deg", "max_shift": "m", "min_lift": "m"}
_LENGTH = Quantity(0.0, 10.0, "m")
_ANGLE = Quantity(0.0, 180.0, "deg")

Signal = str | tuple[str, tuple[str, ...]]  # a name, or an operation and its operands
Instant = float | str
Direction = Literal["below", "above"]  # where a value must be, seen from its bound


def _signal(value: object) -> Signal:
    """Return a signal's name, or an operation with the names of its operands."""
    if isinstance(value, str):
        return Line()(value)
    if isinstance(value, Mapping) and len(value) == 1:
        value = next(iter(value.items()))
    if not (isinstance(value, tuple) and len(value) == 2):
        must = "must be a signal's name, { norm = [...] } or { difference = [...] }"
        refuse("", value, must, error=ValueError)
    operation, given = Choice(tuple(_OPERANDS))(value[0]), value[1]
    names = tuple(map(Line(), given)) if isinstance(given, list | tuple) else ()
    counts = _OPERANDS[operation]
    if len(names) not in counts or len({*names}) < len(names):
        words = f"must be a list of {' or '.join(map(str, counts))} signals, no two alike"
        raise ValueError(f"{operation}: value {excerpt(given)}; {words}")
    return operation, names


def _signal_key(signal: Signal) -> object:
    """Return a signal or an operation as scenario.toml has it."""
    return signal if isinstance(signal, str) else dict([signal])


def check_instant(value: object) -> Instant:
    """Return a time [s], or an event with or without an offset."""
    if not isinstance(value, str):
        return _TIME(value)
    split_instant(value)
    return value


def split_instant(text: str) -> tuple[str, float]:
    """Split `release + 0.5` into the event and its offset [s]."""
    match = _INSTANT.fullmatch(text)
    if match is None or match["event"] not in EVENTS:
        valid = ", ".join(EVENTS)
        must = f'must be seconds or one of {valid}, perhaps with an offset: "release + 0.5"'
        refuse("", text, must, EVENTS, ValueError)
    return match["event"], float((match["sign"] or "") + (match["offset"] or "0"))


Requirements = tuple[Annotated[str, Line()], ...]


@dataclass(frozen=True)
class Reduction:
    """How a window is reduced to a number; criteria.toml says what the fields are."""

    text: str
    takes: Sequence[str] = ()
    has_sign: bool = False
    is_time: bool = False


REDUCTIONS: Final = {name: Reduction(**row) for name, row in _TABLES["reductions"].items()}


@checked
class SignalCriterion:
    """One criterion: a signal, reduced to a number over a window of time, and its bounds.

    A signal of several elements is reduced element by element, and the worst one counts.

    Attributes:
        signal: A recorded signal or element; or ("norm", (a,)), the length of a vector at each
            instant; ("norm", (a, b)), the distance of two; ("difference", (a, b)), a - b.
        reduce: How the window is reduced to a number, one of `REDUCTIONS`.
        from_: Start of the window [s], or an event such as "grasp" or "release + 0.5".
        to: End of the window, in the same form.
        below: Upper bound of the result, in the signal's unit; of a time in s.
        above: Lower bound of the result.
        name: Name in results; "": one made from signal and reduction.
        band: For `settle`, in the signal's unit.
        target: For `settle` and `overshoot`; None: the window's last value.
        level: For the durations, in the signal's unit.
        requirements: Names of requirements that it proves, for reports.

    Raises:
        InputError: A value cannot be used, or the criterion cannot fail or cannot hold.
    """

    signal: Annotated[Signal, PlainValidator(_signal), PlainSerializer(_signal_key)]
    reduce: Annotated[str, Choice(tuple(REDUCTIONS))]
    from_: Annotated[Instant, Field(alias="from"), PlainValidator(check_instant)] = "start"
    to: Annotated[Instant, PlainValidator(check_instant)] = "end"
    below: Annotated[float, _ANY] | None = None
    above: Annotated[float, _ANY] | None = None
    name: Annotated[str, Line()] = ""
    band: Annotated[float, Quantity(1e-12, 1e9)] | None = None
    target: Annotated[float, _ANY] | None = None
    level: Annotated[float, _ANY] | None = None
    requirements: Requirements = ()

    def __post_init__(self) -> None:
        if not self.bounds:
            raise ValueError("below and above: both are missing; must have at least one of them")
        self._check_keys()
        self._check_bounds()

    def _check_keys(self) -> None:
        """Refuse keys that the reduction lacks, or that are of other reductions."""
        takes = REDUCTIONS[self.reduce].takes
        for key in ("band", "target", "level"):
            is_missing = getattr(self, key) is None
            if is_missing and key in takes and key != "target":
                raise ValueError(f"{key}: is missing; reduce = {self.reduce!r} needs it")
            if not is_missing and key not in takes:
                users = [repr(name) for name, each in REDUCTIONS.items() if key in each.takes]
                raise ValueError(f"{key}: only valid with reduce = {' or '.join(users)}")

    @property
    def bounds(self) -> dict[Direction, float]:
        """The bounds that are given, by where the value must be."""
        bounds: dict[Direction, float | None] = {"below": self.below, "above": self.above}
        return {where: bound for where, bound in bounds.items() if bound is not None}

    def _check_bounds(self) -> None:
        """Refuse bounds that hold, or fail, whatever the signal."""
        below, above = self.bounds.get("below", math.inf), self.bounds.get("above", math.nan)
        if above > below:
            raise ValueError(f"above: value {above!r}; {NEVER}; must be at most below, {below!r}")
        is_length = not isinstance(self.signal, str) and self.signal[0] == "norm"
        if REDUCTIONS[self.reduce].has_sign and not is_length:
            return
        what = f"{self.reduce} of {signal_text(self.signal)} is never negative"
        if above <= 0.0:
            raise ValueError(f"above: value {above!r}; {what}, {ALWAYS}; must be above 0")
        if below < 0.0:
            raise ValueError(f"below: value {below!r}; {what}, {NEVER}; must be at least 0")

    def check_window(self, start: float, end: float) -> None:
        """Refuse a window beyond the run from start to end [s], or shorter than a bound on time."""
        first = check_within("from", self.from_, start, end)
        last = check_within("to", self.to, start, end)
        longest = (end if last is None else last) - (start if first is None else first)
        if longest < 0.0:
            raise ValueError(f"to: value {self.to!r} is before from, {self.from_!r}")
        if not REDUCTIONS[self.reduce].is_time:
            return
        window = f"the window lasts {longest:g} s at most"
        if self.bounds.get("below", math.nan) >= longest:
            raise ValueError(f"below: value {self.below!r}; {window}, {ALWAYS}; must be shorter")
        if self.bounds.get("above", math.nan) > longest:
            raise ValueError(f"above: value {self.above!r}; {window}, {NEVER}; must be shorter")

    @property
    def label(self) -> str:
        """Its name, or one made from reduction, signal and window."""
        if self.name:
            return self.name
        start, end = map(_instant_text, (self.from_, self.to))
        window = f" from {start}" if self.from_ not in ("start", 0.0) else ""
        window += f" to {end}" if self.to != "end" else ""
        return f"{self.reduce} {signal_text(self.signal)}{window}"

    @property
    def labels(self) -> dict[Direction, str]:
        """Name in results of each of its bounds, by where the value must be."""
        both = len(self.bounds) > 1
        return {where: f"{self.label} {where}" if both else self.label for where in self.bounds}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recorded signals that it needs."""
        return names_of(self.signal)


def check_within(key: str, instant: Instant, start: float, end: float) -> float | None:
    """Return an instant [s] within a run; None: it is that of an event which only the run knows."""
    event, offset = split_instant(instant) if isinstance(instant, str) else ("", instant)
    origins = {"": 0.0, "start": start, "end": end}
    if event not in origins:
        return None
    at, slack = origins[event] + offset, SLACK * min(end - start, 1.0)
    if not start - slack <= at <= end + slack:
        must = f"must be within the run, from {start:g} to {end:g} s"
        refuse(key, instant, must, error=ValueError)
    return at


def check_both(criterion: object, *names: str) -> None:
    """Refuse a place without how near it must be reached, and the other way round."""
    if len({getattr(criterion, name) is None for name in names}) > 1:
        raise ValueError(f"{' and '.join(names)}: one is missing; must be both or neither")


def _instant_text(instant: Instant) -> str:
    return instant if isinstance(instant, str) else f"{instant:g} s"


def names_of(signal: Signal) -> tuple[str, ...]:
    """Return the recorded signals that a signal or an operation is made of."""
    return (signal,) if isinstance(signal, str) else signal[1]


def read_signal(text: str) -> Signal:
    """Read what `signal_text` writes: a name, `a - b`, `|a|` or `|a - b|`."""
    is_norm = text.startswith("|") and text.endswith("|")
    names = tuple(text.strip("|").split(" - "))
    operation = "norm" if is_norm else "difference"
    return _signal((operation, names) if is_norm or len(names) > 1 else text)


def signal_text(signal: Signal) -> str:
    """Format a signal or an operation, such as `|a - b|`."""
    if isinstance(signal, str):
        return signal
    operation, names = signal
    text = " - ".join(names)
    return f"|{text}|" if operation == "norm" else text


@checked
class BodyCriterion:
    """A criterion on one free body at one instant."""

    body: Annotated[str, Line()]  # its name in the scene
    # Where its origin must be, world frame [m], and how near.
    position: Annotated[tuple[float, float, float], Vector(3, POSITION)] | None = None
    tolerance: Annotated[float, _LENGTH] | None = None  # [m]
    # Largest angle of its z axis to the world's [deg].
    max_tilt: Annotated[float, _ANGLE] | None = None
    max_shift: Annotated[float, _LENGTH] | None = None  # of its origin from where it started [m]
    min_lift: Annotated[float, Quantity(-10.0, 10.0, "m")] | None = None  # above the start [m]
    at: Annotated[Instant, PlainValidator(check_instant)] = "end"  # [s], or an event
    requirements: Requirements = ()  # names of those that it proves, for reports

    def __post_init__(self) -> None:
        check_both(self, "position", "tolerance")
        if not self.bounds:
            raise ValueError(f"no bound; must have at least one of {', '.join(BOUNDS)}")

    def check_window(self, start: float, end: float) -> None:
        """Check that the instant, unless it is an event's, lies within a run [s]."""
        check_within("at", self.at, start, end)

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that are given."""
        values = {name: getattr(self, name) for name in BOUNDS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def labels(self) -> dict[str, str]:
        """Name in results of each of its bounds."""
        at = "" if self.at == "end" else f" at {_instant_text(self.at)}"
        words = {bound: "position" if bound == "tolerance" else bound for bound in self.bounds}
        return {bound: f"{self.body} {word}{at}" for bound, word in words.items()}


@checked
class Success:
    """Conditions for a run to count as a success; those that are None are not judged.

    A scenario has one. It only says what must hold: `judging` measures and judges, and what a
    controller must not exceed at any time belongs to the law.

    Raises:
        InputError: A bound is out of range, or a position has no tolerance.
    """

    # Where the block's centre must be half a second after its release (at the end, if it is not
    # released by then), in world [m], and how near [m]. Yaw and tilt are of that instant, too.
    block_position: Annotated[tuple[float, float, float], Vector(3, POSITION)] | None = None
    position_tolerance: Annotated[float, _LENGTH] | None = None
    # Block about z against the world's axes, modulo 90 deg as it is square [deg].
    max_yaw_error: Annotated[float, Quantity(0.0, 45.0, "deg")] | None = None
    # Block's z axis against the world's [deg].
    max_tilt: Annotated[float, _ANGLE] | None = None
    # Distance between hand and command over all ticks, root mean square and maximum [m].
    tracking_rms: Annotated[float, _LENGTH] | None = None
    tracking_max: Annotated[float, _LENGTH] | None = None
    # Angle between hand and command over all ticks, root mean square [deg].
    orientation_rms: Annotated[float, _ANGLE] | None = None
    # How far the block was lifted while it was held [m].
    min_lift: Annotated[float, Quantity(0.0, 2.0, "m")] | None = None
    # How far the block moved in the hand while it was carried [m].
    max_slip: Annotated[float, Quantity(0.0, 1.0, "m")] | None = None
    # How far it fell when it was released [m], and how hard it was set down [N].
    max_drop: Annotated[float, Quantity(0.0, 10.0, "m")] | None = None
    max_set_down_force: Annotated[float, Quantity(0.0, 1e6, "N")] | None = None
    # Largest share of any limit of the robot; 1 is the limit. See `limits` in summary.json.
    max_limit_share: Annotated[float, Quantity(0.0, 1000.0, "1")] | None = None
    # Largest sum of the forces of unwanted contacts, `plant.unwanted_contact_force` [N].
    max_unwanted_force: Annotated[float, Quantity(0.0, 1e6, "N")] | None = None
    # What the real robot that `preflight` names would refuse, see there.
    max_refusals: Annotated[float, Quantity(0.0, 100.0, "1")] | None = None

    # Warnings of the engines of MuJoCo models, such as contacts for which there was no memory. If
    # it is not stated, one of them fails the run.
    max_engine_warnings: Annotated[float, Quantity(0.0, 1e9, "1")] | None = None

    # Criteria over recorded signals, [[success.signal]].
    signal: tuple[SignalCriterion, ...] = ()
    # Criteria about free bodies by name, [[success.body]].
    body: tuple[BodyCriterion, ...] = ()

    def __post_init__(self) -> None:
        check_both(self, "block_position", "position_tolerance")
        taken = set(field_names(Success))
        for label in (name for each in self._all for name in each.labels.values()):
            if label in taken:
                raise ValueError(f"name {excerpt(label)} is taken; must be unique")
            taken.add(label)

    @property
    def _all(self) -> tuple[SignalCriterion | BodyCriterion, ...]:
        return (*self.signal, *self.body)

    @property
    def required(self) -> dict[str, Requirements]:
        """Requirements of the criteria that state some, by their names in results."""
        stating = [each for each in self._all if each.requirements]
        return {name: each.requirements for each in stating for name in each.labels.values()}

    def within(self, start: float, end: float) -> Self:
        """Return the criteria that a run from `start` to `end` [s] can measure."""

        def fitting(criteria: Iterable[Any]) -> Iterator[Any]:
            for criterion in criteria:
                with suppress(ValueError):
                    criterion.check_window(start, end)
                    yield criterion

        return replace(self, body=tuple(fitting(self.body)), signal=tuple(fitting(self.signal)))

    def check_windows(self, start: float, end: float) -> None:
        """Check that all instants lie within a run from `start` to `end` [s]."""
        for section in ("signal", "body"):
            for number, criterion in enumerate(getattr(self, section), 1):
                with located(f"[[success.{section}]] {number}"):
                    criterion.check_window(start, end)
