"""Start values of a scenario's FMUs, and the poses and times that its table refers to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from ..assets import ELASTIC
from ..assets.franka import HOME_XPOS, HOME_XQUAT
from ..controller.gains import Gains
from ..controller.presets import DEFAULT, OF_IMPEDANCE, OF_SERVOS, PRESETS, preset
from ..fmus.errors import located, refuse
from ..fmus.interface.controller import CONTROLLER
from ..fmus.interface.parameters import grouped
from ..fmus.interface.variables import Value
from ..plant.parameters import BLOCK_HALF_HEIGHT, PlantParameters, block_start_height
from ..result.judging.signals import check_bodies, check_signals
from ..result.recording.storage import TEXTS, addresses
from ..task.scenario import SCENARIO_FILE, TOUCH, Scenario
from ..task.trajectory import TIME_TOLERANCE, StartPose, Trajectory
from .system.assembly import Assembly, assemble

if TYPE_CHECKING:
    from ..task.timing.demand import Timing

StartValues = dict[str, dict[str, Value]]
NOISES: Final = ("joint_noise", "joint_quantisation")  # of [mismatch]


def start_values(scenario: Scenario, assembly: Assembly | None = None) -> StartValues:
    """Parameters of each FMU: scene and gains of our own, the mismatch, then the sections."""
    own: dict[str, Any] = {}
    assembly = assembly or assemble(scenario)
    if not scenario.is_system:
        if assembly.is_ours("plant"):
            own["plant"] = {"scene": scenario.scene, "robot": scenario.robot}
        if assembly.is_ours("controller"):
            own["controller"] = asdict(PRESETS[scenario.gains]) | {
                "reading_delay": scenario.mismatch.known_delay,
                "follow_posture": scenario.has_posture,
                "observer": not TOUCH.isdisjoint(scenario.asked),
                "robot": scenario.robot,
            }
        if scenario.mismatch.has_sensors:
            own["sensors"] = {"robot": scenario.robot}
    return assembly.start_values([own, scenario.mismatch.start_values(), scenario.sections])


def check_criteria(scenario: Scenario, assembly: Assembly) -> None:
    """Check that the signals of the scenario's criteria will be recorded, as long as they need."""
    if scenario.success.signal or scenario.success.body:
        columns = assembly.recorded(scenario.coupling)
        units = {column.name: column.unit for column in columns if column.type not in TEXTS}
        units |= {short: units[name] for short, name in addresses(columns).items()}
        start, folder = assembly.start_time, scenario.folder
        with located(folder / SCENARIO_FILE if folder else scenario.name):
            scenario.success.check_windows(start, start + scenario.duration)
            check_signals(scenario.success.signal, units)
            check_bodies(scenario.success.body, units)


def check_tolerances(scenario: Scenario, assembly: Assembly) -> None:
    """Check that the signals of the scenario's tolerances will be recorded."""
    if scenario.regression.values:
        columns = assembly.recorded(scenario.coupling)
        numbers = [column.name for column in columns if column.type not in TEXTS]
        scenario.regression.check_names([*numbers, *addresses(columns)])


def start_pose(values: StartValues) -> StartPose:
    """Poses of hand and block at the start, the block's as the camera sees it."""
    plant, errors = values["plant"], values.get("sensors", {})
    block = PlantParameters()  # a foreign plant has none
    x, y = (float(plant.get(f"block_pos[{i}]", block.block_pos[i - 1])) for i in (1, 2))
    top = block_start_height(x, y) + BLOCK_HALF_HEIGHT
    yaw = float(plant.get("block_yaw", block.block_yaw))
    dx, dy, dz = (float(errors.get(f"block_position_error[{i}]", 0.0)) for i in (1, 2, 3))
    yaw += float(errors.get("block_yaw_error", 0.0))
    return StartPose(HOME_XPOS, HOME_XQUAT, (x + dx, y + dy, top + dz), yaw)


def resolve(scenario: Scenario, values: StartValues) -> Trajectory:
    """Resolve the scenario's table for these parameters."""
    if scenario.timing != "table":
        return new_timing(scenario, values).trajectory
    return _as_written(scenario, values)


# A run resolves its table several times, as do rows of a sweep.
_from_table = lru_cache(maxsize=4)(Trajectory.from_table)


def _as_written(scenario: Scenario, values: StartValues) -> Trajectory:
    """Resolve the scenario's table with its own times."""
    assert scenario.table is not None
    about = {"interpolation": scenario.interpolation, "align": scenario.align}
    return _from_table(scenario.table, start_pose(values), **about)


def new_timing(scenario: Scenario, values: StartValues) -> Timing:
    """Make the new times of the scenario's table that its `timing` asks for."""
    loaded = law_gains(scenario, values), carried_mass(scenario, values), scenario.timing_share
    blends = tuple(row.blend for row in scenario.rows) if scenario.timing == "optimal" else ()
    timing = _timed(_as_written(scenario, values), blends, *loaded)
    if timing.cycle > scenario.duration + TIME_TOLERANCE:
        takes = f"which the cycle takes within {scenario.timing_share:.0%} of the limits"
        refuse("duration", scenario.duration, f"must be at least {timing.cycle:.3f} s, {takes}")
    return timing


def played_rows(scenario: Scenario, values: StartValues) -> tuple[list[float], list[str]]:
    """Return times and names of the rows that are played, with the new times of `timing`."""
    if scenario.timing == "table":
        return [row.time for row in scenario.rows], [row.name for row in scenario.rows]
    timing = new_timing(scenario, values)
    rows = timing.table.rows if timing.table else scenario.rows
    return timing.trajectory.times.tolist(), [row.name for row in rows]


@lru_cache(maxsize=1)  # a run resolves its table several times
def _timed(
    path: Trajectory, blends: tuple[float, ...], gains: Gains, load: float, share: float
) -> Timing:
    """Return the fastest times, with these blends of the rows, or those of rows as they are."""
    if blends:
        from ..task.timing.optimal import retimed  # noqa: PLC0415 - few scenarios need it

        return retimed(path, np.array(blends), gains, load, share)
    from ..task.timing.stretched import stretched  # noqa: PLC0415 - few scenarios need it

    return stretched(path, gains, load, share)


def law_gains(scenario: Scenario, values: StartValues) -> Gains:
    """Gains of the scenario's controller; the default ones if it has no joint reference of ours."""
    default = preset("default", robot=scenario.robot)
    if "controller" in scenario.fmus:
        return default
    parameters: Any = grouped(CONTROLLER, values["controller"])
    parameters.pop("period")
    gains = Gains(**parameters)
    return gains if gains.law == "reference" else default


def doubts(scenario: Scenario, values: StartValues) -> Iterator[str]:
    """Say which pushes and gains have no effect, or what the gains do not suit."""
    for push in scenario.push:
        if push.start >= scenario.duration:
            yield f"{SCENARIO_FILE}: [[push]] at {push.start:g} s begins after the end"
    if scenario.is_system or "controller" in scenario.fmus:
        return
    is_impedance = values["controller"]["impedance"]
    law, others = ("impedance", OF_SERVOS) if is_impedance else ("servos", OF_IMPEDANCE)
    idle = [key for key in scenario.controller if key.partition("[")[0] in others]
    if idle:
        yield f"[controller] {', '.join(idle)}: without effect, as the law is that of {law}"
    elif causes := _amplified(scenario, values):
        yield (
            f"gains: the default ones do not suit {' and '.join(causes)}: the torque rate or "
            'oscillations may exceed the limits of the robot; gains = "robust" suits them'
        )


def _amplified(scenario: Scenario, values: StartValues) -> list[str]:
    """Noise and elastic joints, if the gains are the default ones, which amplify them."""
    gains, mismatch = law_gains(scenario, values), scenario.mismatch.values
    is_changed = (gains.kp, gains.ik_gain) != (DEFAULT.kp, DEFAULT.ik_gain)
    if is_changed or scenario.gains != "default" or scenario.fmus:
        return []
    causes = [f"mismatch.{key}" for key in NOISES if np.any(mismatch.get(key, 0.0))]
    return causes + [f'scene "{ELASTIC}"'] * (scenario.scene == ELASTIC)


def carried_mass(scenario: Scenario, values: StartValues) -> float:
    """Mass of the block [kg] if the fingers ever close, else 0."""
    grips = [row.opening for row in scenario.rows]
    return float(values["plant"].get("block_mass", 0.0)) if min(grips) < max(grips) else 0.0


def instants(scenario: Scenario) -> NDArray[np.float64]:
    """Instants of all rows of a run, k * dt (n + 1,) [s]."""
    return np.asarray(scenario.step * np.arange(scenario.ticks + 1, dtype=np.float64))
