"""A scenario: a folder with `scenario.toml` and `trajectory.csv`, or the same made in Python."""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, Self, cast, get_args

from pydantic import BeforeValidator, PlainSerializer, PlainValidator, SkipValidation, Strict

from ..assets import SCENES, STEP_SIZE, TORQUE_DRIVEN
from ..assets.franka import DEFAULT_ROBOT, ROBOTS
from ..assets.limits import LIMIT_FILES
from ..controller.presets import PRESETS
from ..fmus.build.engines import check_engine
from ..fmus.errors import InputError, did_you_mean, excerpt, located, refuse
from ..fmus.interface.controller import COMMANDS, OBSERVED, POSTURE_COMMANDS
from ..fmus.interface.plant import FORCE_MAX, FORCES
from ..fmus.interface.tables import INTERFACES
from .client import Client
from .criteria import Requirements, Success
from .fields import (
    Choice,
    Line,
    Quantity,
    Value,
    Vector,
    Whole,
    check_keys,
    checked,
    field_names,
)
from .files import read_toml
from .input_table import InputTable
from .mismatch import Mismatch
from .rules import check_combinations
from .table import TableRow, TrajectoryTable, read_tables
from .tolerances import Tolerances
from .trajectory import INTERPOLATIONS
from .typed import typed
from .values import Values, changed

Coupling = Literal["gauss-seidel", "jacobi", "iterated"]
MAX_DURATION = 3600.0  # s; an hour of recording is 4 GB before compression

SCENARIO_FILE = "scenario.toml"
TABLE_FILE = "trajectory.csv"
SHIPPED_FOLDER = (Path(__file__).parents[1] / "scenarios").resolve()  # a link in a clone
MAX_STEPS = 3_600_000  # an hour at 1 ms

DURATION = Quantity(STEP_SIZE, MAX_DURATION, "s")
# Outputs of PandaController that are computed only if one of them is asked for.
TOUCH = frozenset(f"controller.{name}" for name in OBSERVED)
_FORCE = Quantity(-FORCE_MAX, FORCE_MAX, "N")


Parameter = Annotated[float | bool | str | tuple[float, ...], Value()]
Parameters = Mapping[str, Parameter]  # by name
Regression = Annotated[
    Tolerances,
    BeforeValidator(Tolerances.of),
    PlainSerializer(lambda tolerances: tolerances.section),
]


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
    """A task: the scene, its parameters, the path of the hand, and what counts as success.

    It is what a user asks for, and nothing of how it is run: options are in `Options`, FMUs and
    start values in `Prepared`. `load_scenario` and `Scenario.read` make it from a folder; a program
    makes it from a table, `Scenario("mine", TrajectoryTable(rows), duration=3.0)`. It is checked as
    a whole when it is made, and never changes: `changed` returns another one. Do not make one to
    open FMUs (`read_fmus` does), nor to look at a run, whose recording tells what was done.

    Attributes:
        name: In titles and results; the folder's name, so that it needs no key of its own.
            What identifies a scenario is its content, not its name.
        table: Rows of the hand's path. None: there is no commanded hand, as in a system of
            foreign FMUs, or the route is still to be planned.
        duration: End of the run [s], a whole number of steps: no last step is cut short, and
            all FMUs end at the same instant.
        purpose: One line for lists and pages. It says what the scenario shows, which a reader
            cannot see from its numbers.
        scene: Which of the shipped scenes; a key and not a path, as plant, drawing and limits
            must agree on it. `[fmus] plant` brings one's own.
        robot: Panda or FR3. It is stated once here, since plant, controller, sensors and limits
            all depend on it.
        gains: A named set of the controller's values, tested as a whole. Single values go into
            `controller`.
        coupling: Whether FMUs see values of this step or of the one before; results depend on it,
            so it belongs to the task and not to the options of a run.
        interpolation: The path between rows: it stops at each (quintic), passes through (spline),
            or is as simple as can be (linear).
        timing: Whether the table's times are kept, stretched where they ask too much of the robot
            ("feasible"), or made anew, as short as its limits allow ("optimal").
        timing_share: The share of the limits that new times may use; below 1, since the real arm
            deviates from its model.
        route: "auto": table and duration are planned for the block, its place and what stands in
            the way, when the scenario is prepared; the plan is kept with the run.
        align: Rows relative to the target turn with the block, as the fingers must meet its
            sides. False where a path is meant as it is written.
        plant: Start values of the plant's parameters by name. They are checked against the FMU
            later, as a scenario may bring its own.
        controller: The same of the controller, on top of `gains`; a value of `kp` counts for all
            joints that have none of their own.
        mismatch: How robot and camera differ from the controller's model; apart from `plant`,
            since a controller must not know of it.
        success: What must hold at the end. Without any criterion a run has no verdict, and is
            never a success.
        mujoco: Version of MuJoCo in FMUs that are made of models, and in our controller's, to see
            what a new version changes; empty: the installed one.
        preflight: The real robot whose interface judges the run: what works in a simulation may
            be refused there. Empty: none.
        input_scale: Factor on all inputs of the FMU `plant`; 1.00000000000001 shows how rounding
            errors grow, which says how wide tubes must be.
        expect: "failure" makes a test of something that must not work. It is in the file, so
            that each command judges it in the same way.
        expect_reason: Why it must fail; without a reason, an expected failure hides a fault.
            It is shown wherever the verdict is.
        requirements: Names of the requirements that the run proves as a whole, for reports; a
            criterion may state its own.
        regression: How far a run may deviate from its reference. Contacts amplify rounding, so
            it is the scenario's to say, and not the comparison's.
        push: Forces on hand and block, of some duration. They are inputs of the plant, so that
            they are recorded as any other.
        system: An .ssp file to run instead of our FMUs; it has its own FMUs, connections and
            start time, so most keys do not go with it.
        step: The master's step [s]. Only systems choose it: the twins in C and all references
            are of 1 ms.
        fmus: FMUs by instance, "law.py:Class", a model or an .fmu; paths are relative to the
            folder, so that it can be moved. `plant` and `controller` replace ours. A word names
            one of ours: `controller = "franka"`, which may also stand at the top.
        client: A program that runs beside the FMUs, in the scenario's folder, and ends the run. It
            is part of the task, as a law is: what it commands decides what comes out.
        connect: Connections by input, as an input has one source while an output may feed many.
            Names that fit are connected without it.
        tolerance: Relative tolerance that FMUs are told; 0 leaves it to each of them, as most
            have a fixed step.
        order: In which FMUs step. Empty: as the connections ask, which only a loop of them leaves
            open.
        not_finite: Outputs that may be NaN or infinite. All others end the run, since a NaN
            spreads in silence.
        left_out: Outputs that are neither read nor recorded, as one that an FMU cannot give.
        steps: Steps of an FMU as multiples of the system's, for slow controllers; between them
            its outputs are held.
        inputs: Values of unconnected inputs; `file` names a table of inputs over time. Given here
            or connected, never both.
        input_table: Inputs over time, of that file or of columns in the table. They are texts
            until the FMUs' types are known.
        parameters: Start values of all other FMUs by instance; apart from `plant` and
            `controller`, whose sections every scenario may have.
        folder: Where it was read from, and where relative paths begin; None: it was made in
            Python, and paths are relative to the working directory.

    Raises:
        InputError: A value is out of range; the message names key, value and bound.
    """

    name: Annotated[str, Line()]
    table: TrajectoryTable | None
    duration: Annotated[float, SkipValidation]  # see `_check_time`
    purpose: Annotated[str, Line()] = ""
    scene: Annotated[str, Choice(SCENES)] = "tabletop"
    robot: Annotated[str, Choice(tuple(ROBOTS))] = DEFAULT_ROBOT
    gains: Annotated[str, Choice(tuple(PRESETS))] = "default"
    coupling: Annotated[Coupling, Choice(get_args(Coupling))] = "gauss-seidel"
    interpolation: Annotated[str, Choice(INTERPOLATIONS)] = "quintic"
    timing: Annotated[str, Choice(("table", "feasible", "optimal"))] = "table"
    timing_share: Annotated[float, Quantity(0.1, 1.0, "1")] = 0.9
    route: Annotated[str, Choice(("", "auto"))] = ""
    align: Annotated[bool, Strict()] = True
    plant: Parameters = field(default_factory=dict)
    controller: Parameters = field(default_factory=dict)
    mismatch: Mismatch = field(default_factory=Mismatch)
    success: Success = field(default_factory=Success)
    mujoco: Annotated[str, PlainValidator(check_engine)] = ""
    preflight: Annotated[str, Choice(("", *LIMIT_FILES))] = ""
    input_scale: Annotated[float, Quantity(0.99, 1.01, "1")] = 1.0
    expect: Annotated[str, Choice(("success", "failure"))] = "success"
    expect_reason: Annotated[str, Line()] = ""
    requirements: Requirements = ()
    regression: Regression = field(default_factory=Tolerances)
    push: tuple[Push, ...] = ()
    system: Annotated[str, Line()] = ""
    step: Annotated[float, Quantity(1e-9, 1e6, "s")] = STEP_SIZE
    fmus: Mapping[str, Annotated[str, Line()]] = field(default_factory=dict)
    client: Client | None = None
    connect: Mapping[str, Annotated[str, Line()]] = field(default_factory=dict)
    tolerance: Annotated[float, Quantity(0.0, 1.0, "1")] = 0.0
    order: tuple[Annotated[str, Line()], ...] = ()
    not_finite: tuple[Annotated[str, Line()], ...] = ()
    left_out: tuple[Annotated[str, Line()], ...] = ()
    steps: Mapping[str, Annotated[int, Whole(1, 1_000_000)]] = field(default_factory=dict)
    inputs: Parameters = field(default_factory=dict)
    input_table: InputTable = field(default_factory=InputTable)
    parameters: Mapping[str, Parameters] = field(default_factory=dict)
    folder: Path | None = None

    def __post_init__(self) -> None:
        self._check_time()
        check_combinations(self)
        if not self.system:  # whose start time is in its file
            self.success.check_windows(0.0, self.duration)

    def _check_time(self) -> None:
        if not self.is_system and self.step != STEP_SIZE:
            raise ValueError(f"step: value {self.step!r}; must be {STEP_SIZE} with a trajectory")
        valid = Quantity(0.0, 1e12, "s") if self.is_system else DURATION
        object.__setattr__(self, "duration", valid.check("duration", self.duration))
        off = abs(self.ticks * self.step - self.duration) / max(self.duration, 1.0)
        if not 1 <= self.ticks <= MAX_STEPS or off > 1e-9:
            nearest = self.step * min(max(self.ticks, 1), MAX_STEPS)
            must = f"must be a whole number of ticks of {self.step} s, such as {nearest:.12g}"
            refuse("duration", self.duration, must)

    @property
    def ticks(self) -> int:
        """Number of steps from t = 0 to the end."""
        return round(self.duration / self.step)

    @property
    def is_system(self) -> bool:
        """Whether it is a system of FMUs, without an arm of ours."""
        return not self.is_commanded and "." in self.fmus.get("controller", "a.file")

    @property
    def is_commanded(self) -> bool:
        """Whether there is a commanded hand."""
        return self.table is not None or bool(self.route)

    @property
    def sections(self) -> dict[str, Parameters]:
        """Start values that it states, by FMU."""
        return {"plant": self.plant, "controller": self.controller, **self.parameters}

    @property
    def pushed(self) -> tuple[str, ...]:
        """The pushed bodies, in the order of the plant's inputs."""
        return tuple(body for body in FORCES if any(push.on == body for push in self.push))

    @property
    def commands(self) -> tuple[str, ...]:
        """The controller's inputs that the table commands."""
        if not self.is_commanded:
            return ()
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
        """Whether it brings FMUs, connections, parameters or a client of its own."""
        return bool(self.connect or self.parameters or self.fmus or self.client) or self.is_system

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
    @typed
    def read(cls, folder: str | Path) -> Self:
        """Read a scenario's folder.

        Raises:
            InputError: A file is missing or cannot be used.
        """
        folder = Path(folder)
        path = folder / SCENARIO_FILE
        keys = read_toml(path)
        _name_parts(keys)
        needs_none = keys.get("system") or keys.get("fmus") or keys.get("route")
        table, driven = None, InputTable()
        if not needs_none or (folder / TABLE_FILE).exists():
            table, driven = read_tables(folder / TABLE_FILE)
        with located(path):
            check_keys("", keys, KEYS)
            inputs = keys.get("inputs")
            if isinstance(inputs, Mapping) and "file" in inputs:
                if driven.columns:
                    must = f"must be left out, as {TABLE_FILE} has inputs"
                    refuse("[inputs] file", inputs["file"], must)
                driven = InputTable.read(folder / Line().check("[inputs] file", inputs["file"]))
            name = folder.resolve().name
            return cls(**keys, name=name, table=table, input_table=driven, folder=folder)

    @typed
    def changed(self, values: Values) -> Scenario:
        """Return it with values changed by key, all at once: the one way to change a scenario.

            scenario.changed({"duration": 3, "plant.block_mass": 0.3, "controller.kp[3]": 7})

        Keys are those of `--set`: see `values.py`. A file of `fmus` is relative to the working
        directory, or the class itself is given; that of `inputs` is relative to the scenario's
        folder.

        Raises:
            InputError: A key or a value cannot be used; the key is named.
        """
        return cast("Scenario", changed(self, values))


def _name_parts(keys: MutableMapping[str, object]) -> None:
    """Put a word in place of the section of plant or controller, such as "franka", into [fmus]."""
    for name in INTERFACES:
        fmus = keys.get("fmus", {})
        if isinstance(keys.get(name), str) and isinstance(fmus, dict) and name not in fmus:
            keys["fmus"] = {**fmus, name: keys.pop(name)}


# Keys of scenario.toml; the other fields come from the folder.
KEYS = tuple(
    name for name in field_names(Scenario) if name not in ("name", "table", "input_table", "folder")
)


def shipped_scenarios() -> dict[str, Path]:
    """Return the folder of each scenario that comes with the package, by name."""
    files = sorted(SHIPPED_FOLDER.glob(f"*/{SCENARIO_FILE}"))
    return {file.parent.name: file.parent for file in files}


def is_shipped(scenario: Scenario) -> bool:
    """Tell whether a scenario was read from a folder that comes with the package."""
    return scenario.folder is not None and scenario.folder.resolve().parent == SHIPPED_FOLDER


@typed
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
    if name_or_folder in shipped:
        return Scenario.read(shipped[str(name_or_folder)])
    if os.path.isdir(name_or_folder):  # noqa: PTH112 - false for what cannot be a path, too
        return Scenario.read(folder)
    name = str(name_or_folder)
    parent = f"; did you mean '{folder.parent}'?" if folder.name == SCENARIO_FILE else ""
    raise InputError(
        f"scenario {excerpt(name)}: no such folder; must be one with {SCENARIO_FILE}, or a name "
        f"from `panda-cosim list`{parent or did_you_mean(name, shipped)}"
    )
