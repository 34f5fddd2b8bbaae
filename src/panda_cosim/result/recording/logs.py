"""Logs of robots and other programs, read as recordings: CSV, Parquet and MCAP.

Of an MCAP file, messages in JSON and of ROS 2 are read: a number at `/arm/joint_states`,
`position`, place 1 is the column `arm.joint_states.position[1]`, over the times of the log.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic_core import to_jsonable_python

from ...assets.fields import Array
from ...fmus.errors import InputError, located, one_line, refuse
from ...fmus.extras import needing
from ...fmus.reading import finite_number, open_regular
from ...task.fields import Line, Quantity, checked
from ...task.files import MAX_BYTES, parse_csv, read_text, read_toml
from .reader import Recording
from .storage import read_cells

Columns = dict[str, Array]  # numbers by name, each (n,)

MCAP, PARQUET = ".mcap", ".parquet"
SUFFIXES: Final = (".csv", MCAP, PARQUET)
TIME: Final = "time"  # column of a table, unless it is named; of MCAP, the times of the messages
NS: Final = 1e-9  # [s]


@checked
class LogNames:
    """What a log's columns are in a run: a TOML file.

    Without one, a log has the run's own names, and times in seconds that begin with the run's.
    """

    time: Annotated[str, Line()] = TIME  # its column of times
    seconds: Annotated[float, Quantity(1e-12, 1e12)] = 1.0  # of which one is so many [s]
    start: Annotated[float, Quantity()] | None = None  # the run's time at its first row [s]
    # Columns by the run's signals or elements, one for each element.
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | None) -> Self:
        """Read a file; None: there is none."""
        keys = {} if path is None else read_toml(path)
        with located(path or ""):
            return cls(**keys)

    def columns(self, run: Recording) -> dict[str, str]:
        """Return the log's column of each of a run's columns of numbers, as far as it is known."""
        found = {name: name for name in run.columns if name != TIME}
        for name, columns in self.names.items():
            own = run.elements(name)
            if len(own) != len(columns):
                raise InputError(f"[names] {name}: {len(columns)} columns; must be {len(own)}")
            found |= dict(zip(own, columns, strict=True))
        return found


def is_log(path: Path) -> bool:
    """Whether a file is a log, and no recording of ours."""
    with suppress(InputError):
        Recording.open(path)
        return False
    return path.suffix in SUFFIXES and path.is_file()


def open_log(path: Path, names: Path | None, run: Recording) -> Recording:
    """Open a log, with the names and units of a run's columns; `names` is a file of `LogNames`.

    Raises:
        InputError: It cannot be read, or lacks a column that `names` has.
    """
    given = LogNames.read(names)
    with located(names or path):
        own = given.columns(run)
    found = read_columns(path, {given.time, *own.values()})
    for name in (given.time, *chain(*given.names.values())):
        if name not in found:
            must = "must be one of its columns of numbers; --map names others"
            refuse(f"{path}: column", name, must, found)
    times = given.seconds * found[given.time]
    if given.start is not None and times.size:
        times += given.start - times[0]
    columns = {name: found[column] for name, column in own.items() if column in found}
    log = Recording.of_columns({TIME: times, **columns}, {"complete": True}, run.units, path=path)
    log.check_time()
    return log


def read_columns(path: Path, wanted: Collection[str]) -> Columns:
    """Return the columns of numbers among those that are wanted.

    Raises:
        InputError: It cannot be read, or one that is wanted has other cells.
    """
    if path.suffix == MCAP:
        return _of_mcap(path, wanted)
    cells, columns = read_cells(path) if path.suffix == PARQUET else _of_csv(path), {}
    for name in filter(wanted.__contains__, cells):
        for row, cell in enumerate(cells[name], 1):
            if finite_number(str(cell)) is None:
                refuse(f"{path}: row {row}: {name}", cell, "must be a finite number")
        columns[name] = np.array(cells[name], float)
    return columns


def _of_csv(path: Path) -> dict[str, list[str]]:
    text = read_text(path, MAX_BYTES)
    with located(path):
        table = parse_csv(text)
    return {name: [row[i] for row in table.rows.values()] for i, name in enumerate(table.names)}


def _of_mcap(path: Path, wanted: Collection[str]) -> Columns:
    """Return what messages hold, at the instants of all of them within the spans of all."""
    series = defaultdict[str, dict[float, float]](dict)
    for topic, time, content in messages(path):
        for name, value in _numbers(content, topic.strip("/").replace("/", ".")):
            if name in wanted:
                series[name][time] = value
    if not series:
        return {TIME: np.empty(0)}
    instants = [np.array(list(each)) for each in series.values()]
    times = np.unique(np.concatenate(instants))
    times = times[(times >= max(map(np.min, instants))) & (times <= min(map(np.max, instants)))]
    joined = {n: np.interp(times, [*each], [*each.values()]) for n, each in series.items()}
    return {TIME: times} | joined


def messages(path: Path) -> Iterator[tuple[str, float, Any]]:
    """Yield topic, time [s] and content of the messages of an MCAP file, as JSON has it."""
    with needing("mcap-ros2-support", "logs", str(path)):
        from mcap.reader import make_reader  # noqa: PLC0415 - an extra
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415
    ros = DecoderFactory()
    with open_regular(path) as file:
        try:
            for schema, channel, message in make_reader(file).iter_messages():
                encoding = channel.message_encoding
                decode = json.loads if encoding == "json" else ros.decoder_for(encoding, schema)
                if decode:
                    said = decode(message.data)
                    content = to_jsonable_python(said, bytes_mode="hex", fallback=_parts)
                    yield channel.topic, NS * message.log_time, content
        except Exception as error:  # its reader raises many types for damaged files
            raise InputError(f"{path}: is no whole MCAP file: {one_line(error)}") from error


def _parts(value: Any) -> Any:
    """Return the parts of a message of ROS."""
    names = getattr(value, "__slots__", None)
    return {name: getattr(value, name) for name in names} if names else [*value]


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by their places in it."""
    if isinstance(value, int | float):
        yield name, float(value)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _numbers(each, f"{name}.{key}")
    elif isinstance(value, list):
        for number, each in enumerate(value, 1):
            yield from _numbers(each, f"{name}[{number}]")
