"""A scenario: a folder with `scenario.toml` and `trajectory.csv`, or the same made in Python."""

import dataclasses
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from ...fmus.errors import InputError
from ..checks import (
    check_choice,
    check_number,
    check_numbers,
    excerpt,
    read_text,
    suggestion,
)
from .table import MAX_POSITION, TrajectoryTable
from .tolerances import Tolerances
from .trajectory import INTERPOLATIONS, StartPose, Trajectory

SCENES = ("tabletop", "tutorial")
GAINS = ("default", "tutorial")
COUPLINGS = ("gauss-seidel", "jacobi")
STEP_SIZE = 0.001  # s, one tick: the plant's own step
MAX_DURATION = 3600.0  # s; an hour of recording is 4 GB before compression

SCENARIO_FILE = "scenario.toml"
TABLE_FILE = "trajectory.csv"
SHIPPED_FOLDER = Path(__file__).parents[1] / "library"
_MAX_BYTES = 65_536  # far more than a scenario needs, and no work for the parser
_MAX_FORCE = 1000.0  # N, of a push; the plant takes no more
_MAX_TEXT = 200  # characters

Parameter = float | bool | str | tuple[float, ...]


def _bound(unit: str, high: float) -> dict[str, object]:
    return {"unit": unit, "high": high}


@dataclass(frozen=True)
class Success:
    """What must hold at the end for a run to count as a success; None is not looked at.

    Raises:
        InputError: A bound is out of its own bounds, or a position lacks its tolerance.
    """

    # Where the block's centre shall be at the end, in world [m], and how near [m].
    block_position: tuple[float, float, float] | None = None
    position_tolerance: float | None = field(default=None, metadata=_bound("m", 10.0))
    # Block about z against the world's axes, modulo 90 deg: a square block [deg].
    max_yaw_error: float | None = field(default=None, metadata=_bound("deg", 45.0))
    # Block's z axis against the world's [deg].
    max_tilt: float | None = field(default=None, metadata=_bound("deg", 180.0))
    # Distance of hand and command over all ticks, root mean square and maximum [m].
    tracking_rms: float | None = field(default=None, metadata=_bound("m", 10.0))
    tracking_max: float | None = field(default=None, metadata=_bound("m", 10.0))
    # Angle between hand and command over all ticks, root mean square [deg].
    orientation_rms: float | None = field(default=None, metadata=_bound("deg", 180.0))
    # Height that the block must have been lifted by [m].
    min_lift: float | None = field(default=None, metadata=_bound("m", 2.0))
    # Way of the block in the hand while it is carried [m].
    max_slip: float | None = field(default=None, metadata=_bound("m", 1.0))

    def __post_init__(self) -> None:
        """Check all values that are given."""
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if value is not None and entry.metadata:
                high, unit = entry.metadata["high"], entry.metadata["unit"]
                number = check_number(f"[success] {entry.name}", value, 0.0, high, unit)
                object.__setattr__(self, entry.name, number)
        if self.block_position is not None:
            places = [f"[success] block_position[{i}]" for i in (1, 2, 3)]
            bound = MAX_POSITION
            position = check_numbers(places, self.block_position, -bound, bound, "m")
            object.__setattr__(self, "block_position", position)
        if (self.block_position is None) != (self.position_tolerance is None):
            raise InputError(
                "[success] block_position and position_tolerance: only one is given; "
                "must be both or none"
            )


@dataclass(frozen=True)
class Push:
    """A force on the hand for a while.

    Attributes:
        start: When it begins [s].
        duration: How long it lasts [s].
        force: At the hand's centre of mass, in world axes [N].

    Raises:
        InputError: A value is out of its bounds.
    """

    start: float
    duration: float
    force: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check all values."""
        check_number("[[push]] start", self.start, 0.0, MAX_DURATION, "s")
        check_number("[[push]] duration", self.duration, STEP_SIZE, MAX_DURATION, "s")
        places = [f"[[push]] force[{i}]" for i in (1, 2, 3)]
        force = check_numbers(places, self.force, -_MAX_FORCE, _MAX_FORCE, "N")
        object.__setattr__(self, "force", force)


@dataclass(frozen=True)
class Scenario:
    """What shall happen: who takes part, how they are set, the way, and what success is.

    Raises:
        InputError: A value is out of its bounds; the message names key, value and bound.
    """

    name: str
    table: TrajectoryTable
    duration: float  # s, a whole number of ticks
    purpose: str = ""  # one line
    scene: str = "tabletop"  # one of SCENES
    gains: str = "default"  # one of GAINS: the controller's set of values
    coupling: str = "gauss-seidel"  # one of COUPLINGS
    interpolation: str = "quintic"  # one of INTERPOLATIONS
    align: bool = True  # rows relative to the target turn with the block
    plant: Mapping[str, Parameter] = field(default_factory=dict)  # FMU start values by name
    controller: Mapping[str, Parameter] = field(default_factory=dict)
    push: tuple[Push, ...] = ()  # forces on the hand
    success: Success = field(default_factory=Success)
    regression: Tolerances = field(default_factory=Tolerances)  # how near a reference is near
    folder: Path | None = None  # where it was read from

    def __post_init__(self) -> None:
        """Check all values."""
        check_number("duration", self.duration, STEP_SIZE, MAX_DURATION, "s")
        if abs(self.ticks * STEP_SIZE - self.duration) > 1e-9:
            raise InputError(
                f"duration: value {self.duration!r}; must be a whole number of ticks of "
                f"{STEP_SIZE} s, such as {self.ticks * STEP_SIZE:g}"
            )
        object.__setattr__(self, "duration", float(self.duration))
        for key, valid in _CHOICES.items():
            check_choice(key, getattr(self, key), valid)
        if not isinstance(self.align, bool):
            raise InputError(f"align: value {excerpt(self.align)}; must be true or false")
        _check_line("name", self.name)
        _check_line("purpose", self.purpose)
        for component in ("plant", "controller"):
            checked = _check_parameters(component, getattr(self, component))
            object.__setattr__(self, component, checked)

    @property
    def ticks(self) -> int:
        """Number of steps from t = 0 to the end."""
        return round(self.duration / STEP_SIZE)

    @classmethod
    def read(cls, folder: str | Path, table: TrajectoryTable | None = None) -> Self:
        """Read a scenario's folder.

        Args:
            folder: Holds the two files.
            table: In place of the one in the folder.

        Raises:
            InputError: A file is missing or cannot be used.
        """
        folder = Path(folder)
        path = folder / SCENARIO_FILE
        keys = _parse_toml(path)
        table = table or TrajectoryTable.read(folder / TABLE_FILE)
        try:
            return cls(**_arguments(keys), name=folder.resolve().name, table=table, folder=folder)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def trajectory(self, start: StartPose) -> Trajectory:
        """Resolve the table from the poses at the start."""
        return Trajectory.from_table(
            self.table, start, interpolation=self.interpolation, align=self.align
        )


_CHOICES: dict[str, Collection[str]] = {
    "scene": SCENES,
    "gains": GAINS,
    "coupling": COUPLINGS,
    "interpolation": INTERPOLATIONS,
}
_SECTIONS = ("plant", "controller", "success", "regression")
_KEYS = ("purpose", "duration", *_CHOICES, "align", *_SECTIONS, "push")
_SUCCESS_KEYS = tuple(entry.name for entry in dataclasses.fields(Success))
_TOP_LEVEL = {"plant": "scene", "controller": "gains"}  # of the scenario, not start values


def shipped_scenarios() -> dict[str, Path]:
    """Return the folder of each scenario that comes with the package, by name."""
    files = sorted(SHIPPED_FOLDER.glob(f"*/{SCENARIO_FILE}"))
    return {file.parent.name: file.parent for file in files}


def load_scenario(name_or_folder: str | Path) -> Scenario:
    """Load a shipped scenario by name (a str), or any from its folder (a str or Path).

    A shipped name goes before a folder of that name: write `./tutorial` for the folder.

    Raises:
        InputError: There is no such scenario, or its files cannot be used.
    """
    shipped = shipped_scenarios()
    if isinstance(name_or_folder, str) and name_or_folder in shipped:
        return Scenario.read(shipped[name_or_folder])
    try:
        is_folder = str(name_or_folder) != "" and Path(name_or_folder).is_dir()
    except (OSError, ValueError):  # too long, or a null byte
        is_folder = False
    if is_folder:
        return Scenario.read(name_or_folder)
    raise InputError(
        f"scenario {excerpt(str(name_or_folder))}: no folder of that name; must be a folder with "
        f"{SCENARIO_FILE} and {TABLE_FILE}, or one of {', '.join(shipped)}"
        f"{suggestion(Path(name_or_folder).name, shipped)}"
    )


def _parse_toml(path: Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: is nested too deeply; must be TOML as documented") from None
    except ValueError as error:  # syntax, or an integer of thousands of digits
        raise InputError(f"{path}: {error}; must be TOML") from None


def _arguments(keys: dict[str, Any]) -> dict[str, Any]:
    """Turn the file's keys into the arguments of `Scenario`."""
    _check_keys("key", keys, _KEYS)
    if "duration" not in keys:
        raise InputError("key duration is missing; must be a number of seconds")
    for section in _SECTIONS:
        if not isinstance(keys.get(section, {}), dict):
            raise InputError(f"key {section}: must be a section [{section}]")
    success = keys.get("success", {})
    _check_keys("[success] key", success, _SUCCESS_KEYS)
    return {
        **keys,
        "success": Success(**success),
        "regression": Tolerances.from_section(keys.get("regression", {})),
        "push": _pushes(keys.get("push", [])),
    }


def _pushes(entries: object) -> tuple[Push, ...]:
    names = tuple(entry.name for entry in dataclasses.fields(Push))
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise InputError("key push: must be sections [[push]]")
    for entry in entries:
        _check_keys("[[push]] key", entry, names)
        missing = [name for name in names if name not in entry]
        if missing:
            raise InputError(f"[[push]] {missing[0]} is missing; must have {', '.join(names)}")
    return tuple(Push(**entry) for entry in entries)


def _check_keys(place: str, found: Collection[str], valid: Collection[str]) -> None:
    for key in found:
        if key not in valid:
            raise InputError(
                f"{place} {excerpt(key)} is unknown; valid: {', '.join(valid)}"
                f"{suggestion(key, valid)}"
            )


def _check_line(key: str, value: object) -> None:
    if not isinstance(value, str) or len(value) > _MAX_TEXT or not value.isprintable():
        bound = f"one line of at most {_MAX_TEXT} characters"
        raise InputError(f"{key}: value {excerpt(value)}; must be {bound}")


def _check_parameters(component: str, values: object) -> dict[str, Parameter]:
    """Check the kinds of values; the names are checked against the FMU later."""
    if not isinstance(values, Mapping):
        raise InputError(f"{component}: value {excerpt(values)}; must map names to values")
    own = _TOP_LEVEL[component]
    if own in values:
        raise InputError(f"[{component}] {own}: must stand at the top, before all sections")
    return {
        str(name): _check_parameter(f"[{component}] {name}", value)
        for name, value in values.items()
    }


def _check_parameter(place: str, value: object) -> Parameter:
    if isinstance(value, bool):
        return value
    if isinstance(value, str):
        _check_line(place, value)
        return value
    if isinstance(value, list | tuple):
        if not value:
            raise InputError(f"{place}: value []; must hold at least one number")
        return tuple(check_number(f"{place}[{index}]", item) for index, item in enumerate(value, 1))
    if isinstance(value, Mapping):
        raise InputError(
            f"{place}: is a section; must be a value (a name with dots or brackets needs quotes)"
        )
    return check_number(place, value)
