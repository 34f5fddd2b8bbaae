"""Start values of a scenario's FMUs, and the poses that its table refers to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import HOME_XPOS, HOME_XQUAT
from ...controller.gains import PRESETS, Gains, preset
from ...fmus.errors import InputError
from ...fmus.interface.controller import CONTROLLER
from ...fmus.interface.parameters import ParameterValue, grouped
from ...fmus.interface.variables import Value
from ...plant.parameters import PlantParameters
from ...plant.scene import BLOCK_HALF_HEIGHT, block_start_height
from ..judging.bodies import check_bodies
from ..judging.signals import check_signals
from ..scenario.scenario import SCENARIO_FILE, Scenario
from ..scenario.trajectory import TIME_TOLERANCE, StartPose, Trajectory
from ..system.assembly import Assembly, assemble, layers

if TYPE_CHECKING:
    from ..timing.demand import Timing

Overrides = Mapping[str, Mapping[str, ParameterValue]]
StartValues = dict[str, dict[str, Value]]


def start_values(
    scenario: Scenario, overrides: Overrides | None = None, assembly: Assembly | None = None
) -> StartValues:
    """Parameters of each FMU: the scenario's scene, gains and sections, then the overrides."""
    assembly = assembly or assemble(scenario)
    return assembly.start_values([*layers(scenario, _gains(scenario.gains)), overrides or {}])


def check_criteria(scenario: Scenario, assembly: Assembly | None = None) -> None:
    """Check that the signals of the scenario's criteria will be recorded, as long as they need."""
    if scenario.success.signal or scenario.success.body:
        assembly = assembly or assemble(scenario)
        units = {name: unit for name, (unit, _) in assembly.recorded().items()}
        start = assembly.start_time
        try:
            scenario.success.check_windows(start, start + scenario.duration)
            check_signals(scenario.success.signal, units)
            check_bodies(scenario.success.body, units)
        except (InputError, ValueError) as error:
            place = f"{scenario.folder}/{SCENARIO_FILE}: " if scenario.folder else ""
            raise InputError(f"{place}{error}") from None


def _gains(name: str) -> dict[str, ParameterValue]:
    preset = PRESETS[name]
    return {field.name: getattr(preset, field.name) for field in fields(preset)}


def start_pose(plant: Mapping[str, Value], seen: Mapping[str, Value] | None = None) -> StartPose:
    """Poses of hand and block at the start, the block's as the camera sees it."""
    block = PlantParameters()  # for a foreign plant, which has no block
    x, y = (float(plant.get(f"block_pos[{i}]", block.block_pos[i - 1])) for i in (1, 2))
    top = block_start_height(x, y) + BLOCK_HALF_HEIGHT
    yaw = float(plant.get("block_yaw", block.block_yaw))
    dx, dy, dz = (float((seen or {}).get(f"block_position_error[{i}]", 0.0)) for i in (1, 2, 3))
    yaw += float((seen or {}).get("block_yaw_error", 0.0))
    return StartPose(HOME_XPOS, HOME_XQUAT, (x + dx, y + dy, top + dz), yaw)


def resolve(scenario: Scenario, values: StartValues) -> Trajectory:
    """Resolve the scenario's table for these parameters."""
    if scenario.timing != "table":
        return new_timing(scenario, values).trajectory
    return scenario.trajectory(start_pose(values["plant"], values.get("sensors")))


def new_timing(scenario: Scenario, values: StartValues) -> Timing:
    """Make the new times of the scenario's table that its `timing` asks for."""
    trajectory = scenario.trajectory(start_pose(values["plant"], values.get("sensors")))
    if scenario.timing == "feasible":
        _check_duration(scenario, float(trajectory.times[-1]))  # new times are never earlier
    timing = _remembered(scenario, trajectory, law_gains(scenario, values), values)
    _check_duration(scenario, timing.cycle)
    return timing


def _check_duration(scenario: Scenario, cycle: float) -> None:
    if cycle > scenario.duration + TIME_TOLERANCE:
        raise InputError(
            f"duration: value {scenario.duration!r}; must be at least {cycle:.3f} s, which "
            f"the cycle takes within {scenario.timing_share:.0%} of the limits"
        )


def law_gains(scenario: Scenario, values: StartValues) -> Gains:
    """Gains of the scenario's controller; the default ones if it has no joint reference of ours."""
    if "controller" in scenario.fmus:
        return preset("default")
    given: Any = grouped(CONTROLLER, values["controller"])
    given.pop("period")
    gains = Gains(**given)
    return gains if gains.use_reference else preset("default")


def carried_mass(scenario: Scenario, values: StartValues) -> float:
    """Mass of the block [kg] if the fingers ever close, else 0."""
    grips = [row.opening for row in scenario.table.rows]
    mass = float(values["plant"].get("block_mass", 0.0))
    return mass if min(grips) < max(grips) else 0.0


_MADE: dict[bytes, Timing] = {}  # a run resolves its table several times


def _remembered(
    scenario: Scenario, trajectory: Trajectory, gains: Gains, values: StartValues
) -> Timing:
    share, load = scenario.timing_share, carried_mass(scenario, values)
    blends = np.array([row.blend for row in scenario.table.rows])
    arrays = (trajectory.times, trajectory.positions, trajectory.orientations, trajectory.grips)
    key = b"".join(array.tobytes() for array in (*arrays, blends, np.array([share, load])))
    key += f"{gains} {trajectory.interpolation} {scenario.timing}".encode()
    if key not in _MADE:
        _MADE.clear()
        if scenario.timing == "optimal":
            from ..timing.optimal import retimed  # noqa: PLC0415 - few scenarios need it

            _MADE[key] = retimed(trajectory, blends, gains, load, share)
        else:
            from ..timing.stretch import stretched  # noqa: PLC0415 - few scenarios need it

            _MADE[key] = stretched(trajectory, gains, load, share)
    return _MADE[key]


def instants(scenario: Scenario) -> NDArray[np.float64]:
    """Instants of all rows of a run, k * dt (n + 1,) [s]."""
    times: NDArray[np.float64] = scenario.step * np.arange(scenario.ticks + 1, dtype=np.float64)
    return times
