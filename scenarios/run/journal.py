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
from ..files import read_text

JOURNAL_FILE = "session.jsonl"
FORMAT = 1
END = "end"
_HEAD = {"scenario": str, "kind": str, "fmus": dict}
_MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class Action:
    """One action on a session.

    Attributes:
        tick: Completed steps before it.
        name: The method of `Session` that was called, or `end`.
        arguments: What the method was called with.
    """

    tick: int
    name: str
    arguments: Mapping[str, Any]

    def line(self) -> str:
        """Return the journal's line."""
        return json.dumps({"tick": self.tick, "action": self.name, **self.arguments})


class JournalWriter:
    """Appends actions to a journal; each line is passed to the operating system at once.

    Args:
        path: The file, which must not exist.
        head: Content of the first line besides the format.
    """

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        self._path = path.absolute()  # an FMU may change the working directory
        self._write("x", json.dumps({"format": FORMAT, **head}))

    def append(self, action: Action) -> None:
        """Append an action."""
        self._write("a", action.line())

    def _write(self, mode: str, line: str) -> None:
        try:
            with self._path.open(mode, encoding="utf-8") as file:
                file.write(line + "\n")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written to: {error.strerror}") from error


@dataclass(frozen=True)
class Journal:
    """A journal as it was read.

    Attributes:
        path: The file.
        head: Its first line.
        actions: In order; the last is `end` if the session came to an end.
    """

    path: Path
    head: Mapping[str, Any]
    actions: tuple[Action, ...]

    @classmethod
    def read(cls, place: str | Path) -> Self:
        """Read a journal."""
        path = Path(place)
        if path.is_dir():
            path = path / JOURNAL_FILE
        if not path.exists():
            raise InputError(
                f"{path}: there is no such file; must be the journal of a run of `live` or "
                "Session, or the run's folder"
            )
        lines = io.StringIO(read_text(path, _MAX_BYTES), newline=None)
        head = _checked_head(path, _parse(f"{path}: line 1", lines.readline().rstrip()))
        actions: list[Action] = []
        for number, line in enumerate(lines, start=2):  # ends at the first that cannot be used
            place, last = f"{path}: line {number}", actions[-1] if actions else None
            actions.append(_checked_action(place, _parse(place, line.rstrip()), last))
        return cls(path, head, tuple(actions))


def _parse(place: str, line: str) -> dict[str, Any]:
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        raise InputError(f"{place}: {excerpt(line)}; must be a JSON object") from None
    if not isinstance(content, dict):
        raise InputError(f"{place}: {excerpt(line)}; must be a JSON object")
    return content


def _checked_head(path: Path, head: dict[str, Any]) -> dict[str, Any]:
    if head.get("format") != FORMAT:
        raise InputError(
            f"{path}: line 1: format {excerpt(head.get('format'))}; must be {FORMAT}, as the "
            f"{JOURNAL_FILE} of a session of this version"
        )
    for key, kind in _HEAD.items():
        if not isinstance(head.get(key), kind):
            raise InputError(
                f"{path}: line 1: {key}: {excerpt(head.get(key))}; is missing or wrong"
            )
    if head["kind"] not in get_args(Kind):
        valid = ", ".join(get_args(Kind))
        raise InputError(f"{path}: line 1: kind: {excerpt(head['kind'])}; must be one of {valid}")
    return head


def _checked_action(place: str, content: dict[str, Any], last: Action | None) -> Action:
    tick, name = content.pop("tick", None), content.pop("action", None)
    least = 0 if last is None else last.tick
    if isinstance(tick, bool) or not isinstance(tick, int) or tick < least:
        raise InputError(f"{place}: tick {excerpt(tick)}; must be a whole number from {least} on")
    if not isinstance(name, str):
        raise InputError(f"{place}: action {excerpt(name)}; must be a name")
    if not isinstance(content.get("name", ""), str):
        raise InputError(f"{place}: name {excerpt(content['name'])}; must be that of a variable")
    if last is not None and last.name == END:
        raise InputError(f"{place}: {excerpt(name)} after the end; must be the last line")
    return Action(tick, name, content)
