"""The journal of a session: the actions on a run, and the tick before which each was taken.

`session.jsonl` holds one JSON object per line. The first is the head: `format`, `scenario` (its
name; the scenario itself lies beside the journal in `scenario/`), `kind` and `fmus` (GUID and
SHA-256 of each). Each other line is an action: `tick`, `action` and its arguments:

    {"tick": 1200, "action": "set", "name": "controller.kp", "value": 6.0}
    {"tick": 1300, "action": "release", "name": "plant.push_force"}
    {"tick": 1300, "action": "set_coupling", "coupling": "jacobi"}
    {"tick": 1400, "action": "move_waypoint", "row": 4, "position": [0.5, 0.0, 0.3]}
    {"tick": 6500, "action": "end"}

An action takes effect from its tick on. Without an `end`, the session failed or was killed.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, get_args

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from ...fmus.sources.targets import Kind
from ..fields import check_choice
from ..files import read_text

JOURNAL_FILE = "session.jsonl"
FORMAT = 1
END = "end"
_HEAD = {"scenario": str, "kind": str, "fmus": dict}
_MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class Action:
    """One action on a session."""

    tick: int  # completed steps before it
    name: str  # the method of `Session` that was called, or `end`
    arguments: Mapping[str, Any]


def begin_journal(path: Path, head: Mapping[str, Any]) -> None:
    """Write the first line of a journal, which must not exist."""
    _write(path, "x", {"format": FORMAT, **head})


def append_action(path: Path, action: Action) -> None:
    """Append a line to a journal; it is passed to the operating system at once."""
    _write(path, "a", {"tick": action.tick, "action": action.name, **action.arguments})


def _write(path: Path, mode: str, content: Mapping[str, Any]) -> None:
    try:
        with path.open(mode, encoding="utf-8") as file:
            file.write(json.dumps(content) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written to: {error.strerror}") from error


@dataclass(frozen=True)
class Journal:
    """A journal as it was read."""

    path: Path
    head: Mapping[str, Any]  # its first line
    actions: tuple[Action, ...]  # in order; the last is `end` if the session came to an end

    @classmethod
    def read(cls, place: str | Path) -> Self:
        """Read a journal."""
        path = Path(place)
        if path.is_dir():
            path = path / JOURNAL_FILE
        if not path.exists():
            raise InputError(
                f"{path}: no such file; must be the journal of a run of `live` or "
                "Session, or the run's folder"
            )
        lines = io.StringIO(read_text(path, _MAX_BYTES), newline=None)
        first = f"{path}: line 1"
        head = _checked_head(first, _parse(first, lines.readline()))
        actions: list[Action] = []
        for number, line in enumerate(lines, start=2):  # ends at the first that cannot be used
            place = f"{path}: line {number}"
            actions.append(_action(place, _parse(place, line), actions))
        return cls(path, head, tuple(actions))


def _parse(place: str, line: str) -> dict[str, Any]:
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError(f"{place}: {excerpt(line.rstrip())}; must be a JSON object")
    return content


def _checked_head(place: str, head: dict[str, Any]) -> dict[str, Any]:
    if head.get("format") != FORMAT:
        raise InputError(
            f"{place}: format {excerpt(head.get('format'))}; must be {FORMAT}, as the "
            f"{JOURNAL_FILE} of a session of this version"
        )
    for key, kind in _HEAD.items():
        if not isinstance(head.get(key), kind):
            raise InputError(f"{place}: {key}: {excerpt(head.get(key))}; is missing or wrong")
    check_choice(f"{place}: kind", head["kind"], get_args(Kind))
    return head


def _action(place: str, content: dict[str, Any], before: list[Action]) -> Action:
    tick, name = content.pop("tick", None), content.pop("action", None)
    least = before[-1].tick if before else 0
    if isinstance(tick, bool) or not isinstance(tick, int) or tick < least:
        raise InputError(f"{place}: tick {excerpt(tick)}; must be a whole number from {least} on")
    if not isinstance(name, str):
        raise InputError(f"{place}: action {excerpt(name)}; must be a name")
    if not isinstance(content.get("name", ""), str):
        raise InputError(f"{place}: name {excerpt(content['name'])}; must be that of a variable")
    if before and before[-1].name == END:
        raise InputError(f"{place}: {excerpt(name)} after the end; must be the last line")
    return Action(tick, name, content)
