"""The backend MuJoCo: the plant in Python is the reference, and `mj_step` for any other model."""

import math
import os
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_instance import OK, STEP, Instance, Unpacked, unpacked, with_content
from panda_cosim.assets import SCENES
from panda_cosim.fmus.interface.plant import CTRL_MAX, CTRL_MIN, HOME_CTRL
from panda_cosim.fmus.sources.model_fmu import ModelOptions, load, model_fmu
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import Plant
from panda_cosim.plant.signals import OUTPUTS

pytestmark = pytest.mark.own_process
NAMES = OUTPUTS.names or ()
CASES: tuple[dict[str, Any], ...] = (
    {},
    {"block_pos": (0.65, 0.3), "block_yaw": 0.7, "block_mass": 0.5, "block_friction": 0.5},
    {"scene": "tutorial", "block_pos": (0.45, 0.3)},
    {"block_pos": (1.0, -1.0), "block_yaw": math.pi},
    {"scene": "elastic", "payload": 0.5},
    {
        "joint_friction": (0.2, 0.4, 0.6, 0.8, 1.0, 0.3, 0.5),
        "joint_viscous": (3.0, 0.0, 1.0, 0.5, 0.1, 0.2, 0.3),
        "link_mass_scale": (1.0, 0.95, 1.05, 1.1, 0.9, 1.02, 1.2),
        "servo_scale": (0.9, 1.1, 1.0, 0.95, 1.05, 1.2, 0.8),
        "torque_limit_scale": (0.3, 0.5, 0.9, 1.0, 0.4, 0.8, 1.1),
        "payload": 1.5,
    },
    {"scene": "motors"},  # driven to the floor
)
DOWN = (0.0, 40.0, 0.0, -5.0, 0.0, 0.0, 0.0)  # [N.m]
EDGES = (0.45, 0.85, 0.1, 0.5, 0.0, -1.0, 1.0)  # [m] of the table, of the base, of the floor


@pytest.fixture(params=(2, 3), ids=("fmi2", "fmi3"))
def fmu(request):
    return unpacked("native", "plant", request.param)


def as_fmi(value: Any) -> tuple[float, ...]:
    """Elements of a parameter."""
    if isinstance(value, str):
        return (SCENES.index(value) + 1,)
    return value if isinstance(value, tuple) else (value,)


def differing(it: Instance, plant: Plant) -> list[str]:
    """Names of outputs that differ in a bit."""
    return [n for n in NAMES if np.array(it.get(n)).tobytes() != plant.outputs[n].tobytes()]


@pytest.mark.parametrize("seed", range(len(CASES)))
def test_all_outputs_have_the_bits_of_the_plant_in_python(seed):
    case, source = CASES[seed], np.random.default_rng(seed)
    plant = Plant(PlantParameters(**case))
    start = {name: as_fmi(value) for name, value in case.items()}
    both = [Instance(unpacked("native", "plant", version)).start(start) for version in (2, 3)]
    for it in both:
        assert not differing(it, plant)
        it.set("torque", *DOWN)
    plant.inputs["torque"], unwanted, ctrl = DOWN, 0.0, np.array(HOME_CTRL)
    for i in range(600):  # servo targets that wander, gripper included, and pushes
        ctrl = np.clip(ctrl + source.normal(0, 0.003, 8) * [*[1] * 7, 400], CTRL_MIN, CTRL_MAX)
        push = source.normal(0, 5, 3)
        plant.inputs["ctrl"], plant.inputs["push_force"] = ctrl, push
        plant.inputs["link4_force"] = -push
        plant.step()
        for it in both:
            it.set("ctrl", *ctrl)
            it.set("push_force", *push)
            it.set("link4_force", *-push)
            assert it.step(i * STEP) == OK, it.messages()
        unwanted = max(unwanted, plant.outputs["unwanted_contact_force"])
        if i % 40 == 0 or i == 599 or unwanted:
            assert not any(differing(it, plant) for it in both), i
    assert (unwanted > 10.0) == (case.get("scene") == "motors"), "the palm hits the floor [N]"


@pytest.mark.parametrize(
    "source",
    ["data qpos 17", "data nothing 0", "data qpos", "jac body 99 0", "mass_matrix 15", "what 1",
     "contact_sensors 99", "held qpos -1", "data qpos 0 0", "contact_bodies 1 99", "-"],
)  # fmt: skip
def test_a_source_that_does_not_fit_the_model_is_refused(tmp_path, source):
    def change(table: str) -> str:
        lines = [line.split("\t") for line in table.splitlines(keepends=True)]
        (line,) = (fields for fields in lines if "hand_xpos" in fields)
        line[-2] = source
        return "".join(map("\t".join, lines))

    place = unpacked("native", "plant", 2).copy(tmp_path / "fmu", change)
    with pytest.raises(AssertionError, match="hand_xpos: "):
        Instance(place).start()


# Any model.


def _package_files(name: str, pattern: str) -> list[Path]:
    spec = find_spec(name)
    return sorted(Path(spec.origin).parent.glob(pattern)) if spec and spec.origin else []


MODELS = [
    *sorted((Path(__file__).parents[1] / "mjcf").glob("*.xml")),
    *_package_files("mujoco", "testdata/*.xml"),
    *_package_files("gymnasium", "envs/mujoco/assets/*.xml"),
    *sorted(Path(os.environ.get("MENAGERIE_ROOT", "missing")).glob("franka_emika_panda/panda.xml")),
]


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_any_model_steps_as_mj_step(path, tmp_path):
    model, source = load(path), np.random.default_rng(1)
    steps = 300 if model.nv < 50 else 60
    data, dt = mujoco.MjData(model), float(model.opt.timestep)
    keyframe = "home" if "home" in (model.key(i).name for i in range(model.nkey)) else ""
    if keyframe:  # outside which the menagerie's controls may not start
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
    fmu = model_fmu(path, ModelOptions(keyframe), "Other")
    instances = [Instance(with_content(fmu, tmp_path / f"{v}", v)).start() for v in (2, 3)]
    low, high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, [[-0.3], [0.3]])
    for i in range(steps):
        data.ctrl[:] = low + (high - low) * source.random(model.nu)
        mujoco.mj_step(model, data)
        for it in instances:
            if model.nu:
                assert it.set("ctrl", *data.ctrl) == OK
            if i == steps // 2:
                state = it.save()
                assert it.step(i * dt, 7 * dt) == OK
                assert it.load(state) == it.drop(state) == OK
            assert it.step(i * dt, dt) == OK, it.messages()
        if i % 10 == 0 or i == steps - 1:
            for it, name in product(instances, ("qpos", "qvel") if model.nq else ()):
                assert it.get(name) == getattr(data, name).tolist(), (name, i)
    assert not model.nq or np.abs(data.qpos - model.qpos0).max() > 1e-6


# Where the block can start.


def starts(plant: Unpacked, scene: str, x: float, y: float, yaw: float) -> list[Any]:
    """The block's pose, or why it is refused: of the native plant, and of Python's."""
    outcomes: list[Any] = []
    it = Instance(plant)
    try:
        it.start({"scene": as_fmi(scene), "block_pos": (x, y), "block_yaw": (yaw,)})
        outcomes.append(it.get("qpos")[9:16])
    except AssertionError as error:
        outcomes.append(_refusal(str(error)))
    it.free()
    try:
        plant_in_python = Plant(PlantParameters(scene=scene, block_pos=(x, y), block_yaw=yaw))
        outcomes.append(plant_in_python.outputs["qpos"][9:16].tolist())
    except ValueError as error:
        outcomes.append(_refusal(str(error)))
    return outcomes


def _refusal(text: str) -> str:
    """From the first words that both plants have in common, to the line's end."""
    return text[text.index("would start") :].partition("\n")[0]


def places() -> Any:
    """Coordinates: anywhere, on an edge, and a hair beside one."""
    edge = st.sampled_from(EDGES)
    beside = st.builds(lambda x, d: x + d, edge, st.floats(-0.06, 0.06))
    hair = st.builds(lambda x, d: x + d, edge, st.sampled_from([-1e-12, 1e-12, -1e-16, 1e-16]))
    return (st.floats(-1.0, 1.0) | edge | beside | hair).filter(lambda x: -1.0 <= x <= 1.0)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(SCENES), places(), places(), st.floats(-np.pi, np.pi))
def test_both_plants_agree_on_where_the_block_can_start(scene, x, y, yaw):
    native, python = starts(unpacked("native", "plant", 2), scene, x, y, yaw)
    assert native == python
