"""The section [mismatch]: differences of robot and camera from the controller's model.

A preset draws a robot at random, and the seed says which; single keys take precedence over it.
The presets' sizes are assumptions, such as one meets after a calibration and after years of use;
none has been measured on a robot. For comparison: Franka gives a repeatability of 0.1 mm (data
sheet), and joint friction of 0.2 to 1.3 N.m follows from C. Gaz et al., "Dynamic Identification of
the Franka Emika Panda Robot With Retrieval of Feasible Parameters", IEEE RA-L 4(4), 2019.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Final, cast

import numpy as np
from pydantic import PlainValidator

from ..fmus.interface.plant import PLANT
from ..fmus.interface.sensors import SENSORS
from ..fmus.interface.variables import Interface
from .fields import Choice, Quantity, Vector, Whole, checked

JointValues = tuple[float, ...]

SENSOR_KEYS: Final = frozenset(v.name for v in SENSORS.of("parameter")) - {"seed", "robot"}


@dataclass(frozen=True)
class Sizes:
    """Magnitudes of the differences of a preset."""

    joint_offset: float  # standard deviation of each encoder's offset [rad]
    joint_noise: float  # of each encoder, root mean square [rad]
    friction: tuple[float, float]  # ends that each joint's Coulomb friction is drawn between [N.m]
    share: float  # largest difference of a link's mass and of a servo's gains [1]
    delay: float  # of the readings [s]
    block_position: float  # standard deviation of the camera's error in x, y and z [m]
    block_yaw: float  # the same in yaw [rad]


SIZES: Final[Mapping[str, Sizes]] = {
    "calibrated": Sizes(math.radians(0.02), 1e-5, (0.2, 1.0), 0.05, 0.001, 5e-4, math.radians(0.3)),
    "worn": Sizes(math.radians(0.06), 3e-5, (0.6, 3.0), 0.15, 0.003, 1.5e-3, math.radians(0.9)),
}


def draw_robot(sizes: Sizes, seed: int) -> dict[str, Any]:
    """Draw one robot and one error of the camera; a key of [mismatch] each. The seed says which."""
    draw = np.random.default_rng(seed)

    def normal(deviation: float, count: int) -> JointValues:
        return tuple((deviation * draw.standard_normal(count)).tolist())

    def uniform(low: float, high: float) -> JointValues:
        return tuple(draw.uniform(low, high, 7).tolist())

    return {
        "joint_offset": normal(sizes.joint_offset, 7),
        "joint_noise": (sizes.joint_noise,) * 7,
        "delay": sizes.delay,
        "hand_pose_source": "model",
        "block_position_error": normal(sizes.block_position, 3),
        "block_yaw_error": normal(sizes.block_yaw, 1)[0],
        "joint_friction": uniform(*sizes.friction),
        "link_mass_scale": uniform(1.0 - sizes.share, 1.0 + sizes.share),
        "servo_scale": uniform(1.0 - sizes.share, 1.0 + sizes.share),
    }


def _as(interface: Interface, name: str) -> PlainValidator:
    """Check a key as the FMU's parameter of its name: one number for all elements, or each."""
    variable = interface.variable(name)
    bounds = cast("tuple[float, float]", (variable.minimum, variable.maximum))
    quantity, part = Quantity(*bounds, str(variable.unit)), variable.multiple_of
    several = Vector(variable.size, quantity)

    def check(value: object) -> Any:
        if not variable.shape:
            number = quantity(value)
            if part and abs(number - round(number / part) * part) > 1e-9:
                raise ValueError(f"value {value!r} s; must be a whole number of ticks of {part} s")
            return number
        is_list = isinstance(value, list | tuple | np.ndarray)
        return several(value) if is_list else (quantity(value),) * variable.size

    return PlainValidator(check)


@checked
class Mismatch:
    """Differences of robot and camera from the controller's model; None: as in the preset.

    A scenario has one, which gives plant and sensors their parameters (`start_values`). What the
    controller knows of, such as a heavier block, belongs to `Scenario.plant` instead.
    """

    preset: Annotated[str, Choice(("nominal", *SIZES))] = "nominal"
    seed: Annotated[int, Whole(0, 2**32 - 1)] = 0  # of the preset's robot, and of all noise
    # Parameters of PandaSensors, which is used if one of them is given.
    joint_offset: Annotated[JointValues, _as(SENSORS, "joint_offset")] | None = None
    joint_noise: Annotated[JointValues, _as(SENSORS, "joint_noise")] | None = None
    joint_quantisation: Annotated[JointValues, _as(SENSORS, "joint_quantisation")] | None = None
    velocity_noise: Annotated[JointValues, _as(SENSORS, "velocity_noise")] | None = None
    delay: Annotated[float, _as(SENSORS, "delay")] | None = None
    dropout: Annotated[float, _as(SENSORS, "dropout")] | None = None
    hand_pose_source: Annotated[str, Choice(("plant", "model"))] | None = None
    block_position_error: Annotated[JointValues, _as(SENSORS, "block_position_error")] | None = None
    block_yaw_error: Annotated[float, _as(SENSORS, "block_yaw_error")] | None = None
    # Parameters of PandaPlant.
    joint_friction: Annotated[JointValues, _as(PLANT, "joint_friction")] | None = None
    joint_viscous: Annotated[JointValues, _as(PLANT, "joint_viscous")] | None = None
    link_mass_scale: Annotated[JointValues, _as(PLANT, "link_mass_scale")] | None = None
    servo_scale: Annotated[JointValues, _as(PLANT, "servo_scale")] | None = None
    torque_limit_scale: Annotated[JointValues, _as(PLANT, "torque_limit_scale")] | None = None
    payload: Annotated[float, _as(PLANT, "payload")] | None = None

    @property
    def given(self) -> dict[str, Any]:
        """Keys and values that differ from the defaults."""
        return {n: v for n, v in asdict(self).items() if v != getattr(Mismatch, n)}

    @property
    def values(self) -> dict[str, Any]:
        """Parameters that are not at the FMUs' defaults: the preset's, and those given."""
        sizes = SIZES.get(self.preset)
        drawn = {} if sizes is None else draw_robot(sizes, self.seed)
        values = drawn | {n: v for n, v in self.given.items() if n not in ("preset", "seed")}
        if {"payload", "link_mass_scale"} & values.keys():  # the truth would tell of these masses
            values.setdefault("hand_pose_source", "model")
        return values

    @property
    def known_delay(self) -> float:
        """Delay of the readings that the controller was set up for [s]: the preset's."""
        return SIZES[self.preset].delay if self.preset in SIZES else 0.0

    @property
    def has_sensors(self) -> bool:
        """Whether PandaSensors is connected between plant and controller."""
        return any(self.values.get(name) for name in SENSOR_KEYS)

    def items(self, name: str) -> Sequence[Any]:
        """Return the items of a key: the FMU's own if neither preset nor scenario gives any."""
        variable = (SENSORS if name in SENSOR_KEYS else PLANT).end(name, "parameter")
        own = [each.start for each in variable.scalars(0)] if variable else []
        return cast("Sequence[Any]", self.values.get(name, own))

    def start_values(self) -> dict[str, dict[str, Any]]:
        """Start values by FMU and parameter."""
        parts: dict[str, dict[str, Any]] = {"plant": {}, "sensors": {"seed": float(self.seed)}}
        for name, value in self.values.items():
            parts["sensors" if name in SENSOR_KEYS else "plant"][name] = value
        return parts if self.has_sensors else {"plant": parts["plant"]}
