"""The summary of a run: its metrics, and the verdict that they decide.

An incomplete run is never a success. Of a complete one, a missed criterion outranks one that was
not measured. Whatever shows or counts runs asks `Summary.verdict`.

`summary.json` has the format 4. Format 3 lacks `verdict`, format 2 limited the margins, and format
1 has none; all are read. `definitions` says what each number means; keys end with their units. A
value that could not be measured is null.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from pydantic_core import to_jsonable_python

from ...fmus.errors import InputError, excerpt, one_line, refuse
from ...task.files import read_integer
from .criterion import Criterion, missed_text, smallest_margin, verdict_of
from .verdict import Verdict
from .verdicts import (
    ENDED,
    FAILURE,
    INCOMPLETE,
    MISSED,
    NO_CRITERIA,
    NOT_MEASURED,
    SUCCESS,
    UNEXPECTED,
)

if TYPE_CHECKING:
    from ..recording import Recording

SUMMARY_FILE: Final = "summary.json"
FORMAT: Final = 4
Metrics = dict[str, Any]  # by key, as JSON holds them
_SECTIONS: Final = ("tracking", "orientation", "block", "contact", "limits", "preflight", "energy",
                    "engine", "timing")  # fmt: skip
# These differ from run to run, like the wall clock.
_WALL: Final = ("wall_s", "real_time_factor", "overruns", "worst_lateness_s")

_KINDS: Final = {str: "a text", bool: "true or false", tuple: "a list", dict: "a table of values"}


@dataclass(frozen=True)
class Summary:
    """Metrics of a run, and its verdict.

    `summarize` measures one, and `open` and `read` take one from a file. What a run without some
    signals, or an older file, lacks is empty.
    """

    scenario: str = ""
    complete: bool = True  # whether it ran to its end
    reason: str | None = None  # why not
    end: Verdict = ENDED  # how it ended, if it is not complete
    expect: str = "success"  # or "failure"
    expect_reason: str = ""  # why a failure
    order: tuple[str, ...] = ()  # of stepping
    late: tuple[str, ...] = ()  # connections whose target gets values of the step before
    criteria: tuple[Criterion, ...] = ()
    row_ends: tuple[Metrics, ...] = ()  # of rows with `until`: whether and when each ended early
    # Instants of grasp, release and so on [s]; None: did not happen.
    events: dict[str, float | None] = field(default_factory=dict)
    tracking: Metrics = field(default_factory=dict)
    orientation: Metrics = field(default_factory=dict)
    block: Metrics = field(default_factory=dict)
    contact: Metrics = field(default_factory=dict)
    limits: Metrics = field(default_factory=dict)
    first_limit: Metrics | None = None
    preflight: Metrics = field(default_factory=dict)  # empty: the scenario names no robot
    energy: Metrics = field(default_factory=dict)
    engine: Metrics = field(default_factory=dict)
    timing: Metrics = field(default_factory=dict)
    stepped_by: str | None = None  # "kernel", "fmpy" or both; None: judged later
    code: Metrics = field(default_factory=dict)  # what runs in each FMU
    # Wall time of the steps by FMU and call [s]; empty: not asked for.
    profile: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def open(cls, folder: Path, **known: Any) -> Self:
        """Read the summary in a run's folder; without one, only what is known of its end."""
        path = folder / SUMMARY_FILE
        if not path.is_file():
            return cls(**known)
        try:
            return cls.read(json.loads(path.read_text(encoding="utf-8"), parse_int=read_integer))
        except (OSError, ValueError, InputError) as error:
            raise InputError(f"{path}: cannot be read: {one_line(error)}") from None

    @classmethod
    def of(cls, recording: Recording) -> Self:
        """Read the summary beside a recording, or say no more than how that ended."""
        complete, reason = recording.complete, recording.reason
        return cls.open(recording.path.parent, complete=complete, reason=reason)

    @classmethod
    def read(cls, content: Any) -> Self:
        """Take the values of a `summary.json` of any format."""
        if not isinstance(content, Mapping):
            raise InputError(f"value {excerpt(content)}; must be the content of a {SUMMARY_FILE}")
        ends = {end.word: end for end in INCOMPLETE}
        end = ends.get(str(content.get("verdict")), ENDED)
        values: Metrics = {"criteria": Criterion.read(content), "end": end}
        for name, default in vars(cls()).items():
            value = content.get(name)
            if name not in values and value is not None:
                value = tuple(value) if isinstance(value, list) else value
                if default is not None and not isinstance(value, type(default)):
                    refuse(name, content[name], f"must be {_KINDS[type(default)]}")
                values[name] = value
        return cls(**values)

    @property
    def verdict(self) -> Verdict:
        """What the run came to."""
        if not self.complete:
            return self.end
        judged, fails = verdict_of(self.criteria), self.expect == "failure"
        if judged == "not measured":
            return NOT_MEASURED
        if judged == "missed":
            return FAILURE if fails else MISSED
        return UNEXPECTED if fails else SUCCESS if self.criteria else NO_CRITERIA

    @property
    def success(self) -> bool:
        """Whether it is complete and all criteria hold."""
        return self.verdict in (SUCCESS, NO_CRITERIA, UNEXPECTED)

    @property
    def as_expected(self) -> bool:
        """Whether it is complete, with a verdict, which is the expected one."""
        return self.verdict.level != "bad"

    @property
    def margin(self) -> float | None:
        """Smallest margin of the criteria; None: there is no verdict, or there are none."""
        return smallest_margin(self.criteria)

    @property
    def detail(self) -> str:
        """What decided the verdict, with values: criteria, or why the run ended."""
        if not self.complete:
            return str(self.reason or "no reason is known")
        if self.verdict is UNEXPECTED:
            return f"is a success, but a failure is expected: {self.expect_reason}"
        count = len(self.criteria)
        held = f"{count} of {count} criteria hold" if count else NO_CRITERIA.word
        return missed_text(self.criteria) or held

    @property
    def headline(self) -> str:
        """The verdict in a line."""
        return self.verdict.headline.format(detail=self.detail, why=self.expect_reason)

    @property
    def brief(self) -> str:
        """The verdict in a few words, without values."""
        verdict, wanted = self.verdict, verdict_of(self.criteria)
        if verdict in (NO_CRITERIA, UNEXPECTED):
            return verdict.word
        names = ", ".join(each.name for each in self.criteria if each.word == wanted)
        short = self.complete and verdict is not SUCCESS
        return f"{verdict.word}: {names if short else self.detail}"

    def costs(self) -> Iterator[str]:
        """Say where the wall time went, by FMU and call, the most expensive first."""
        whole = self.timing.get("wall_s") or 0.0
        sums = {name: sum(calls.values()) for name, calls in self.profile.items()}
        for name in sorted(sums, key=sums.__getitem__, reverse=True):
            calls = sorted(self.profile[name].items(), key=lambda call: -call[1])
            python = " (Python)" * (self.code.get(name) == "python")
            parts = ", ".join(f"{call} {seconds:.3g} s" for call, seconds in calls)
            yield f"{name}{python}: {sums[name]:.3g} s of {whole:.3g} s: {parts}"
        if sums:
            yield f"the master itself: {max(whole - sum(sums.values()), 0.0):.3g} s"

    def numbers(self) -> Iterator[tuple[str, Any]]:
        """Yield the metrics by place, such as `limits.torque_share[2]`; the wall clock is none."""
        for section in _SECTIONS:
            for key, value in getattr(self, section).items():
                if key not in _WALL:
                    yield from _numbers(f"{section}.{key}", value)

    def to_dict(self) -> Metrics:
        """Return plain values, as JSON holds them."""
        judged = {name: getattr(self, name) for name in ("success", "as_expected", "margin")}
        content = {"format": FORMAT, "verdict": self.verdict.word, **judged, **vars(self)}
        return dict(to_jsonable_python(content, exclude={"end"}, inf_nan_mode="null"))


def _numbers(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, list | tuple):
        for number, item in enumerate(value, 1):
            yield from _numbers(f"{name}[{number}]", item)
    elif value is None or isinstance(value, int | float):
        yield name, value
