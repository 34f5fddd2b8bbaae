"""A scenario: a folder with `scenario.toml` and `trajectory.csv`, or the same made in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import BeforeValidator, PlainValidator, SkipValidation

from ..assets import SCENES, STEP_SIZE, TORQUE_DRIVEN
from ..assets.franka import DEFAULT_ROBOT, ROBOTS
from ..assets.limits import LIMIT_FILES
from ..fmus.build.engines import check_engine
from ..fmus.errors import InputError, did_you_mean, excerpt, located, refuse
from ..fmus.interface.controller import COMMANDS, OBSERVED, POSTURE_COMMANDS
from ..fmus.interface.plant import FORCE_MAX, FORCES
from .criteria import Success
from .fields import (
    Choice,
    Line,
    Quantity,
    Switch,
    Vector,
    Whole,
    check_keys,
    check_rules,
    checked,
    field_names,
    numbers,
)
from .files import read_toml
from .input_table import InputTable
from .mismatch import Mismatch
from .table import TableRow, TrajectoryTable, read_tables
from .tolerances import Tolerances
from .trajectory import INTERPOLATIONS, StartPose, Trajectory
from .values import Values, changed

GAINS = ("default", "robust", "tutorial", "impedance")
TIMINGS = ("table", "feasible", "optimal")
ROUTES = ("", "auto")
Coupling = Literal["gauss-seidel", "jacobi", "iterated"]
COUPLINGS = get_args(Coupling)
Expectation = Literal["success", "failure"]
MAX_DURATION = 3600.0  # s; an hour of recording is 4 GB before compression

SCENARIO_FILE = "scenario.toml"
TABLE_FILE = "trajectory.csv"
SHIPPED_FOLDER = (Path(__file__).parents[1] / "scenarios").resolve()  # a link in a clone
MAX_STEPS = 3_600_000  # an hour at 1 ms
MAX_MULTIPLE = 1_000_000  # steps of the system in one of an FMU
_MAX_BYTES = 65_536  # far more than a scenario needs, and quick to parse

DURATION = Quantity(STEP_SIZE, MAX_DURATION, "s")
SYSTEM_DURATION = Quantity(0.0, 1e12, "s")
# Keys that act on the project's plant and controller.
_OF_ARM = ("scene", "robot", "gains", "interpolation", "timing", "timing_share", "align",
           "push")  # fmt: skip
# Outputs of PandaController that are computed only if one of them is asked for.
TOUCH = frozenset(f"controller.{name}" for name in OBSERVED)
_FORCE = Quantity(-FORCE_MAX, FORCE_MAX, "N")


def _parameter(value: object) -> float | bool | str | tuple[float, ...]:
    """Check a parameter's kind; name and bounds are checked against the FMU later."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str):
        return Line()(value)
    if isinstance(value, Mapping):
        raise ValueError(
            "is a section; must be a value (a name with dots or brackets needs quotes)"
        )
    if not isinstance(value, Sequence | np.ndarray):
        number = Quantity()(value)
        return int(value) if isinstance(value, int) and abs(value) > 2**53 else number
    if not len(value):
        raise ValueError("value []; must hold at least one number")
    return numbers(value, Quantity())


Parameter = Annotated[float | bool | str | tuple[float, ...], PlainValidator(_parameter)]


@checked
class Push:
    """A constant force on a body for some time.

    Attributes:
        start: Start time [s].
        duration: Duration [s].
        force: Force at the centre of mass, world axes [N].
        on: The body: "hand", "block", or "link1" to "link7".

    Raises:
        InputError: A value is out of range.
    """

    start: Annotated[float, Quantity(0.0, MAX_DURATION, "s")]
    duration: Annotated[float, DURATION]
    force: Annotated[tuple[float, float, float], Vector(3, _FORCE)]
    on: Annotated[str, Choice(tuple(FORCES))] = "hand"


@checked
class Scenario:
    """A task: the scene, the parameters, the path of the hand, and what counts as success.

    Raises:
        InputError: A value is out of range; the message names key, value and bound.
    """

    name: Annotated[str, Line()]
    table: TrajectoryTable | None  # None: a system without a commanded hand
    duration: Annotated[float, SkipValidation]  # see `_check_time`: a whole number of steps
    purpose: Annotated[str, Line()] = ""
    scene: Annotated[str, Choice(SCENES)] = "tabletop"
    robot: Annotated[str, Choice(tuple(ROBOTS))] = DEFAULT_ROBOT
    gains: Annotated[str, Choice(GAINS)] = "default"  # the controller's set of values
    coupling: Annotated[Coupling, Choice(COUPLINGS)] = "gauss-seidel"
    interpolation: Annotated[str, Choice(INTERPOLATIONS)] = "quintic"
    # "feasible": rows that ask too much of the robot get more time. "optimal": all times are made
    # anew, as short as a share of the limits allows.
    timing: Annotated[str, Choice(TIMINGS)] = "table"
    timing_share: Annotated[float, Quantity(0.1, 1.0, "1")] = 0.9
    # "auto": table and duration are planned for the block, its place and what stands in the way.
    route: Annotated[str, Choice(ROUTES)] = ""
    align: Annotated[bool, Switch()] = True  # rows relative to the target turn with the block
    plant: Mapping[str, Parameter] = field(default_factory=dict)  # FMU start values by name
    controller: Mapping[str, Parameter] = field(default_factory=dict)
    mismatch: Mismatch = field(default_factory=Mismatch)  # robot and camera against the model
    success: Success = field(default_factory=Success)
    # Version of MuJoCo in the FMUs that are made of models, and in our controller's; empty: the
    # installed one.
    mujoco: Annotated[str, PlainValidator(check_engine)] = ""
    # The real robot whose interface the run is judged by; empty: none.
    preflight: Annotated[str, Choice(("", *LIMIT_FILES))] = ""
    # Factor on all inputs of the FMU `plant`; 1.00000000000001 shows how rounding errors grow.
    input_scale: Annotated[float, Quantity(0.99, 1.01, "1")] = 1.0
    # With an expected failure and its reason, a scenario tests that something does not work.
    expect: Annotated[Expectation, Choice(get_args(Expectation))] = "success"
    expect_reason: Annotated[str, Line()] = ""
    # How far a run may deviate from its reference recording.
    regression: Annotated[Tolerances, BeforeValidator(Tolerances.of)] = field(
        default_factory=Tolerances
    )
    push: tuple[Push, ...] = ()  # forces on hand and block
    system: Annotated[str, Line()] = ""  # an .ssp file to run instead of our FMUs
    step: Annotated[float, Quantity(1e-9, 1e6, "s")] = (
        STEP_SIZE  # only for systems; the project's FMUs take 1 ms
    )
    # FMUs by instance: "law.py:Class", a model or an .fmu; paths from the folder.
    fmus: Mapping[str, Annotated[str, Line()]] = field(default_factory=dict)
    connect: Mapping[str, Annotated[str, Line()]] = field(default_factory=dict)  # input = output
    tolerance: Annotated[float, Quantity(0.0, 1.0, "1")] = 0.0  # of FMUs; 0: as they say
    order: tuple[Annotated[str, Line()], ...] = ()  # of stepping; empty: by the connections
    not_finite: tuple[Annotated[str, Line()], ...] = ()  # outputs that may be NaN or infinite
    # Steps of an FMU as multiples of the system's.
    steps: Mapping[str, Annotated[int, Whole(1, MAX_MULTIPLE)]] = field(default_factory=dict)
    # Values of unconnected inputs; `file`: a table of inputs over time.
    inputs: Mapping[str, Parameter] = field(default_factory=dict)
    input_table: InputTable = field(default_factory=InputTable)
    # Start values of FMUs that are neither `plant` nor `controller`.
    parameters: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    folder: Path | None = None  # where it was read from

    def __post_init__(self) -> None:
        self._check_time()
        check_rules(self._rules_of_sections() | self._rules_of_arm() | self._rules_of_table())
        if not self.system:  # whose start time is in its file
            self.success.check_windows(0.0, self.duration)

    def _rules_of_sections(self) -> dict[str, object]:
        """What a system and sections must not be combined with; message, and whether it is."""
        of_arm, of_models = map(self._first_changed, (_OF_ARM, ("mujoco", "input_scale")))
        sections = (("plant", "scene"), ("plant", "robot"), ("controller", "gains"),
                    ("controller", "robot"))  # fmt: skip
        low = next((f"[{name}] {key}" for name, key in sections if key in self.sections[name]), "")
        return {
            f"{TABLE_FILE}: must be there, unless there is system, [fmus] or route": (
                self.table is None and not (self.system or self.fmus or self.route)
            ),
            "system: cannot be combined with [fmus] and [connect]; must be one of them": (
                self.system and (self.fmus or self.connect)
            ),
            f"{of_arm}: acts only on a scenario with a {TABLE_FILE}; must be left out here, as a "
            "system has none": self.is_system and of_arm,
            f"{of_models}: must be left out with system, which has its own FMUs": (
                self.system and of_models
            ),
            'coupling: value "iterated"; must be another one with [steps], or with a '
            f"{TABLE_FILE}": self.coupling == "iterated" and (self.steps or not self.is_system),
            "mismatch: only valid with the project's own plant": (
                self.mismatch.values and self.is_system
            ),
            f"{low}: must stand at the top, before all sections": low,
        }

    def _rules_of_arm(self) -> dict[str, object]:
        """What scene, gains and controller must not be combined with."""
        is_ours = not self.is_system and "controller" not in self.fmus
        has_impedance = self.controller.get("impedance", self.gains == "impedance")
        reaction = self.controller.get("reaction", "none")
        has_torque = any(name.partition("[")[0] == "plant.torque" for name in self.inputs)
        return {
            f"scene: value {self.scene!r}; must come with a controller that gives torques, such as "
            'gains = "impedance", or [fmus] controller = "my_law.py:MyLaw"': (
                self.is_torque_driven and is_ours and not has_impedance
            ),
            f'gains: value {self.gains!r}; must come with scene = "{TORQUE_DRIVEN}"': (
                has_impedance and is_ours and not self.is_torque_driven
            ),
            f'[inputs] plant.torque: acts only with scene = "{TORQUE_DRIVEN}"': (
                has_torque
                and "plant" not in self.fmus
                and not (self.is_system or self.is_torque_driven)
            ),
            f"[controller] reaction: value {reaction!r} moves servos; with impedance, it must be "
            '"none"': has_impedance and reaction != "none",
        }

    def _rules_of_table(self) -> dict[str, object]:
        """What the table, its route and its success must not be combined with."""
        return {
            'until: is in the table; must have interpolation "quintic" or "linear", and timing '
            '"table"': (self.interpolation == "spline" or self.timing != "table") and self.untils,
            'grip_force: the gripper of scene "tutorial" is too weak for it; must be left out of '
            "the table": self.scene == "tutorial" and any(row.grip_force for row in self.rows),
            f"route: value {self.route!r}; must come with [success] block_position, and with the "
            "project's own controller": self.route
            and (not self.success.block_position or self.system or "controller" in self.fmus),
            'q1 to q7: must be left out of the table with gains = "tutorial" or timing = '
            '"optimal"': self.has_posture
            and (self.gains == "tutorial" or self.timing == "optimal"),
            'expect_reason: must say why expect is "failure", and only then be set': (
                (self.expect == "failure") != bool(self.expect_reason)
            ),
        }

    def _first_changed(self, keys: Sequence[str]) -> str:
        return next((key for key in keys if getattr(self, key) != getattr(Scenario, key)), "")

    def _check_time(self) -> None:
        if not self.is_system and self.step != STEP_SIZE:
            raise ValueError(f"step: value {self.step!r}; must be {STEP_SIZE} with a trajectory")
        valid = SYSTEM_DURATION if self.is_system else DURATION
        object.__setattr__(self, "duration", valid.check("duration", self.duration))
        off = abs(self.ticks * self.step - self.duration) / max(self.duration, 1.0)
        if not 1 <= self.ticks <= MAX_STEPS or off > 1e-9:
            nearest = self.step * min(max(self.ticks, 1), MAX_STEPS)
            raise ValueError(
                f"duration: value {self.duration!r}; must be a whole number of ticks of "
                f"{self.step} s, such as {nearest:.12g}"
            )

    @property
    def ticks(self) -> int:
        """Number of steps from t = 0 to the end."""
        return round(self.duration / self.step)

    @property
    def is_system(self) -> bool:
        """Whether it is a system of FMUs without a commanded hand."""
        return self.table is None and not self.route

    @property
    def sections(self) -> dict[str, Mapping[str, Parameter]]:
        """Start values that it states, by FMU."""
        return {"plant": self.plant, "controller": self.controller, **self.parameters}

    @property
    def pushed(self) -> tuple[str, ...]:
        """The pushed bodies, in the order of the plant's inputs."""
        return tuple(body for body in FORCES if any(push.on == body for push in self.push))

    @property
    def commands(self) -> tuple[str, ...]:
        """The controller's inputs that the table commands."""
        return (*COMMANDS, *POSTURE_COMMANDS) if self.has_posture else COMMANDS

    @property
    def inputs_move(self) -> bool:
        """Whether the inputs over time are columns of the table, which end early with its rows."""
        return self.input_table.times == tuple(row.time for row in self.rows)

    @property
    def untils(self) -> tuple[str, ...]:
        """What ends rows of the table early."""
        return tuple(row.until for row in self.rows if row.until)

    @property
    def rows(self) -> tuple[TableRow, ...]:
        """Rows of the table, if there is one."""
        return self.table.rows if self.table else ()

    @property
    def has_posture(self) -> bool:
        """Whether the table commands joint positions, too."""
        return self.table is not None and self.table.has_posture

    @property
    def has_own_parts(self) -> bool:
        """Whether it brings FMUs, connections or parameters of its own."""
        return bool(self.connect or self.parameters or self.fmus) or self.is_system

    @property
    def is_torque_driven(self) -> bool:
        """Whether the arm has motors: the controller's ctrl are torques, then the gripper."""
        return self.scene == TORQUE_DRIVEN and not self.is_system

    @property
    def asked(self) -> frozenset[str]:
        """Signals that criteria are about, and touch if it is observed, which are recorded then."""
        names = (name for criterion in self.success.signal for name in criterion.names)
        asked = frozenset(name.partition("[")[0] for name in names)
        reacts = self.controller.get("reaction", "none") != "none"
        observed = reacts or self.controller.get("observer") or "external" in "".join(self.untils)
        return asked | TOUCH if observed else asked

    @classmethod
    def read(cls, folder: str | Path) -> Self:
        """Read a scenario's folder.

        Raises:
            InputError: A file is missing or cannot be used.
        """
        folder = Path(folder)
        path = folder / SCENARIO_FILE
        keys = read_toml(path, _MAX_BYTES)
        needs_none = keys.get("system") or keys.get("fmus") or keys.get("route")
        table, driven = None, InputTable()
        if not needs_none or (folder / TABLE_FILE).exists():
            table, driven = read_tables(folder / TABLE_FILE)
        with located(path):
            check_keys("", keys, KEYS)
            inputs = keys.get("inputs", {})
            file = inputs.get("file") if isinstance(inputs, Mapping) else None
            if file is not None and driven.columns:
                must = f"must be left out, as {TABLE_FILE} has inputs"
                refuse("[inputs] file", file, must)
            if file is not None:
                driven = InputTable.read(folder / Line().check("[inputs] file", file))
            name = folder.resolve().name
            return cls(**keys, name=name, table=table, input_table=driven, folder=folder)

    def changed(self, values: Values) -> Scenario:
        """Return it with values changed by key, all at once: the one way to change a scenario.

            scenario.changed({"duration": 3, "plant.block_mass": 0.3, "controller.kp[3]": 7})

        Keys are those of `--set`: see `values.py`. A file of `fmus` is relative to the working
        directory, that of `inputs` to the scenario's folder.

        Raises:
            InputError: A key or a value cannot be used; the key is named.
        """
        return changed(self, values)

    def trajectory(self, start: StartPose) -> Trajectory:
        """Resolve the table from the poses at the start."""
        assert self.table is not None
        return Trajectory.from_table(
            self.table, start, interpolation=self.interpolation, align=self.align
        )


# Keys of scenario.toml; the other fields come from the folder.
_FROM_FOLDER = ("name", "table", "input_table", "folder")
KEYS = tuple(name for name in field_names(Scenario) if name not in _FROM_FOLDER)


def shipped_scenarios() -> dict[str, Path]:
    """Return the folder of each scenario that comes with the package, by name."""
    files = sorted(SHIPPED_FOLDER.glob(f"*/{SCENARIO_FILE}"))
    return {file.parent.name: file.parent for file in files}


def is_shipped(scenario: Scenario) -> bool:
    """Tell whether a scenario was read from a folder that comes with the package."""
    return scenario.folder is not None and scenario.folder.resolve().parent == SHIPPED_FOLDER


def load_scenario(name_or_folder: Scenario | str | Path) -> Scenario:
    """Load a shipped scenario by name (a str), or any scenario from its folder (a str or Path).

    One that is loaded is returned as it is.

    A shipped name takes precedence over a folder of that name: write `./tutorial` for the folder.

    Raises:
        InputError: There is no such scenario, or its files cannot be used.
    """
    if isinstance(name_or_folder, Scenario):
        return name_or_folder
    shipped, folder = shipped_scenarios(), Path(name_or_folder)
    if isinstance(name_or_folder, str) and name_or_folder in shipped:
        return Scenario.read(shipped[name_or_folder])
    is_folder = False
    with suppress(OSError, ValueError):  # too long, or a null byte
        is_folder = name_or_folder != "" and folder.is_dir()
    if is_folder:
        return Scenario.read(folder)
    name = str(name_or_folder)
    parent = f"; did you mean '{folder.parent}'?" if folder.name == SCENARIO_FILE else ""
    raise InputError(
        f"scenario {excerpt(name)}: no such folder; must be one with {SCENARIO_FILE}, or a name "
        f"from `panda-cosim list`{parent or did_you_mean(name, shipped)}"
    )
