"""Native FMUs of MuJoCo models, and what is checked on them, each check in a process of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from native_support import OK, TIME, Instance, Row, Table, parameter, unpacked
from numpy.typing import NDArray
from panda_cosim.assets import SCENES
from panda_cosim.fmus.interface.plant import CTRL_MAX, CTRL_MIN, HOME_CTRL
from panda_cosim.plant.parameters import ARM_AND_PALM, BLOCK, FINGERS
from panda_cosim.plant.plant import OUTPUTS, Plant, PlantParameters
from panda_cosim.plant.scene import load_scene

NAMES = OUTPUTS.names or ()
CHECKS: list[Callable[[Path, int], None]] = []


def check(function: Callable[[Path, int], None]) -> Callable[[Path, int], None]:
    """Collect a check."""
    CHECKS.append(function)
    return function


def mjb(model: Any) -> bytes:
    """A model as MuJoCo's binary file."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def panda(scene: str) -> Any:
    """A scene's model."""
    return load_scene(PlantParameters(scene=scene))


def plant_table() -> Table:
    """The plant's variables."""
    m = panda(SCENES[0])
    hand, block, target = m.body("hand").id, m.body("obj").id, m.site("target").id
    sensors = [m.sensor(f"{side}_finger_contact").id for side in ("left", "right")]
    touching = " ".join(str(m.body(name).id) for name in (BLOCK, *FINGERS, *ARM_AND_PALM))
    bodies = [m.body(name).id for name in ("left_finger", "right_finger", "work_space")]
    floor, table = m.geom("floor").id, m.geom("table").id
    friction = 3 * m.geom("obj_geom").id
    links = " ".join(str(m.body(f"link{i}").id) for i in range(1, 8))
    servos = " ".join(map(str, range(7)))
    rows = (
        Row("ctrl", "input", (8,), "data ctrl 0",
            start=HOME_CTRL, minimum=CTRL_MIN, maximum=CTRL_MAX),
        Row("push_force", "input", (3,), f"data xfrc_applied {6 * hand}"),
        Row("torque", "input", (7,), "motors 0"),
        Row("qpos", shape=(16,), source="data qpos 0"),
        Row("qvel", shape=(15,), source="data qvel 0"),
        Row("hand_xpos", shape=(3,), source=f"data xpos {3 * hand}"),
        Row("hand_xquat", shape=(4,), source=f"data xquat {4 * hand}"),
        Row("target_xpos", shape=(3,), source=f"data site_xpos {3 * target}"),
        Row("target_xmat", shape=(9,), source=f"data site_xmat {9 * target}"),
        Row("jac", shape=(6, 7), source=f"jac body {hand} 0 1 2 3 4 5 6"),
        Row("qfrc_bias", shape=(7,), source="data qfrc_bias 0"),
        Row("actuator_force", shape=(8,), source="held actuator_force 0"),
        Row("contact_force", source=f"contact_sensors {sensors[0]} {sensors[1]}"),
        Row("unwanted_contact_force", source=f"unwanted_contacts {touching}"),
        Row("support_force", source=f"support_contacts {touching}"),
        Row("table_force", source=f"contact_bodies {bodies[-1]} {bodies[0]} {bodies[1]}"),
        Row("mass_matrix", shape=(7, 7), source="mass_matrix 0 1 2 3 4 5 6"),
        Row("pressed", source=f"contact_bodies {m.body('left_finger').id} {block}"),
        Row("inertia", shape=(2, 2), source="mass_matrix 0 3"),
        parameter("scene", 1.0, source="scene", kind="Enumeration", minimum=(1.0,),
                  maximum=(float(len(SCENES)),)),
        parameter("block_pos", 0.4, -0.2, source=f"free_xy {block} clear stand {floor} {table}",
                  minimum=(-1.0,), maximum=(1.0,)),
        parameter("block_yaw", 0.0, source=f"free_yaw {block}"),
        parameter("block_mass", 0.18, source=f"body_mass {block}", minimum=(0.001,)),
        parameter("block_friction", 1.0, source=f"model geom_friction {friction}"),
        parameter("joint_friction", *[0.0] * 7, source="added dof_frictionloss 0"),
        parameter("joint_viscous", *[0.0] * 7, source="added dof_damping 0"),
        parameter("link_mass_scale", *[1.0] * 7, source=f"scaled_mass {links}"),
        parameter("servo_scale", *[1.0] * 7, source=f"scaled_servo {servos}"),
        parameter("torque_limit_scale", *[1.0] * 7, source=f"scaled_force {servos}"),
        parameter("payload", 0.0, source=f"added body_mass {hand}"),
        parameter("gravity", 0.0, 0.0, -9.81, source="model gravity 0", tunable=True),
        TIME,
    )  # fmt: skip
    options = [("model", f"{scene}.mjb") for scene in SCENES]
    return Table(rows, (*options, ("key", str(m.key("home").id))))


PLANT = plant_table()


def build_plant(folder: Path) -> Path:
    """Write the plant's FMU."""
    return unpacked(folder, "mujoco", PLANT, {f"{s}.mjb": mjb(panda(s)) for s in SCENES})


def control(seed: int, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Servo targets that wander, gripper included, and pushes."""
    source = np.random.default_rng(seed)
    wander = np.cumsum(source.normal(0, 0.003, (steps, 8)) * [*[1] * 7, 400], axis=0)
    return np.clip(np.array(HOME_CTRL) + wander, CTRL_MIN, CTRL_MAX), source.normal(
        0, 5, (steps, 3)
    )


def differing(it: Instance, plant: Plant) -> list[str]:
    """Names of outputs that differ in a bit."""
    return [n for n in NAMES if np.array(it.get(n)).tobytes() != plant.outputs[n].tobytes()]


CASES = (
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


@check
def all_outputs_have_the_bits_of_the_plant_in_python(folder: Path, version: int) -> None:
    for seed, case in enumerate(CASES):
        plant = Plant(PlantParameters(**case))  # type: ignore[arg-type]
        it = Instance(folder, PLANT, version)
        for name, value in case.items():
            number = float(SCENES.index(value) + 1) if isinstance(value, str) else value
            assert it.set(name, *(number if isinstance(number, tuple) else (number,))) == OK
        it.start()
        assert not differing(it, plant)
        it.set("torque", *DOWN)
        plant.inputs["torque"], unwanted = DOWN, 0.0
        for i, (ctrl, push) in enumerate(zip(*control(seed, 600), strict=True)):
            it.set("ctrl", *ctrl)
            it.set("push_force", *push)
            plant.inputs["ctrl"], plant.inputs["push_force"] = ctrl, push
            assert it.step(i * 0.001) == OK, it.messages()
            plant.step()
            unwanted = max(unwanted, plant.outputs["unwanted_contact_force"])
            if i % 40 == 0 or unwanted:
                assert not differing(it, plant), (case, i)
        assert (unwanted > 10.0) == (case.get("scene") == "motors"), "the palm hits the floor [N]"
        assert not differing(it, plant)
        inertia = np.zeros((plant.model.nv, plant.model.nv))
        mujoco.mj_fullM(plant.model, plant.data, inertia)
        assert it.get("inertia") == [inertia[a, b] for a in (0, 3) for b in (0, 3)]
        it.free()


@check
def states_restore_every_bit(folder: Path, version: int) -> None:
    it = Instance(folder, PLANT, version)
    it.set("block_mass", 0.7)
    it.start()
    ctrl, push = control(3, 300)

    def go(one: Instance, first: int, last: int) -> list[list[float]]:
        for i in range(first, last):
            one.set("ctrl", *ctrl[i])
            one.set("push_force", *push[i])
            assert one.step(i * 0.001) == OK
        return [one.get(name) for name in (*NAMES, "pressed")]

    go(it, 0, 120)
    at_save = [it.get(name) for name in NAMES]
    state = it.save()
    expected = go(it, 120, 300)
    assert it.load(state) == OK
    assert [it.get(name) for name in NAMES] == at_save
    assert go(it, 120, 300) == expected
    other = Instance(folder, PLANT, version).start()
    other.steps(5)
    status, copy = other.deserialize(it.serialize(state))
    assert status == OK
    assert other.load(copy) == OK
    assert go(other, 120, 300) == expected
    assert it("Reset") == OK
    it.set("block_mass", 0.7)
    it.start()
    go(it, 0, 120)
    assert go(it, 120, 300) == expected
    it.free()
    other.free()


@check
def instances_in_threads_do_not_meet(folder: Path, version: int) -> None:
    ends: dict[int, list[float]] = {}

    def work(seed: int) -> None:
        for _ in range(3):
            it = Instance(folder, PLANT, version).start()
            for i, row in enumerate(control(seed % 3, 60)[0]):
                it.set("ctrl", *row)
                it.step(i * 0.001)
            ends.setdefault(seed, []).extend(it.get("qpos"))
            it.free()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300.0)
        assert not thread.is_alive()
    for seed in range(6):
        assert ends[seed] == ends[seed % 3]
        assert ends[seed][:16] == ends[seed][16:32]


@check
def what_does_not_fit_the_model_is_refused(folder: Path, version: int) -> None:
    resources = {f"{s}.mjb": (folder / "resources" / f"{s}.mjb").read_bytes() for s in SCENES}
    library = next((folder / "binaries" / "linux64").glob("Model.*")).read_bytes()
    for i, source in enumerate(
        ("data qpos 17", "data nothing 0", "data qpos", "jac body 99 0", "mass_matrix 15", "what 1",
         "contact_sensors 99", "held qpos -1", "data qpos 0 0", "contact_bodies 1 99", "")
    ):  # fmt: skip
        table = Table((Row("y", source=source), TIME), (("model", "tabletop.mjb"),))
        place = unpacked(
            folder.parent / f"{version}{i}", "mujoco", table, resources, library=library
        )
        with pytest.raises(AssertionError, match="y: "):
            Instance(place, table, version).start()
    table = Table((Row("y", source="data qpos 0"),), (("model", "cut.mjb"),))
    cut = resources["tabletop.mjb"][:5000]
    place = unpacked(
        folder.parent / f"{version}cut", "mujoco", table, {"cut.mjb": cut}, library=library
    )
    with pytest.raises(AssertionError, match=r"cut\.mjb"):
        Instance(place, table, version)


MODELS = sorted((Path(__file__).parent / "mjcf").glob("*.xml"))


def model_table(m: Any) -> Table:
    """The state of any model, and its controls."""
    rows = (
        Row("qpos", shape=(m.nq,), source="data qpos 0"),
        Row("qvel", shape=(m.nv,), source="data qvel 0"),
        Row("act", shape=(m.na,), source="data act 0"),
        Row("ctrl", "input", (m.nu,), "data ctrl 0"),
        Row("sensors", shape=(m.nsensordata,), source="held sensordata 0"),
    )
    return Table(
        (*(row for row in rows if row.shape[0]), TIME), (("model", "m.mjb"),), float(m.opt.timestep)
    )


def a_model_steps_as_mj_step(folder: str, path: str, steps: int) -> None:
    """Compare an FMU of any model with MuJoCo, in both versions, with a rollback in the middle."""
    m = mujoco.MjModel.from_xml_path(path)
    table, data = model_table(m), mujoco.MjData(m)
    place = unpacked(Path(folder) / "fmu", "mujoco", table, {"m.mjb": mjb(m)})
    instances = [Instance(place, table, version).start() for version in (2, 3)]
    source, dt = np.random.default_rng(1), float(m.opt.timestep)
    saved: list[Any] = []
    for i in range(steps):
        ctrl = source.uniform(-0.3, 0.3, m.nu)
        data.ctrl[:] = ctrl
        mujoco.mj_step(m, data)
        for it in instances:
            if m.nu:
                assert it.set("ctrl", *ctrl) == OK
            if i == steps // 2:
                saved.append(it.save())
                assert it.step(i * dt, 7 * dt) == OK
                assert it.load(saved[-1]) == OK
            assert it.step(i * dt, dt) == OK, it.messages()
        if i % 10 == 0 or i == steps - 1:
            for it, name in product(instances, ("qpos", "qvel", "act")):
                if name in table.references:
                    assert it.get(name) == getattr(data, name).tolist(), (name, i)
    for it, state in zip(instances, saved, strict=True):
        assert it.drop(state) == OK
        it.free()


def run(name: str, folder: str, version: int) -> None:
    """Run the check of a name."""
    next(c for c in CHECKS if c.__name__ == name)(Path(folder), version)
