"""What a page needs to simulate a prepared run by itself, in result/view/source/src/engine.

The page has plant and controller of `fmus/native` as modules, and MuJoCo in its own version. Here
are their tables of variables, with the scenario's start values, their models as MJCF, how they are
connected, and the inputs that the scenario gives. What else a scenario can have is refused by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import numpy as np

from ...assets.arm import written
from ...assets.franka import ROBOTS
from ...controller.model import arm_spec
from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.build.native import NativeFmu, table
from ...fmus.interface.plant import FORCES
from ...fmus.interface.units import PLAIN
from ...fmus.interface.variables import Value, Variable
from ...fmus.master.step import SWITCHED
from ...fmus.sources.model_fmu import mjcf_of
from ...fmus.sources.targets import own_fmu
from ...plant.parameters import PlantParameters
from ...plant.scene import compiled_scene
from ...run.prepare import Prepared
from ...run.session import Session
from ...run.system.parts import Part
from ...task.fields import check_rules
from ...task.scenario import Scenario
from ...task.trajectory import COMMANDS, POSTURE_COMMANDS, Trajectory, turns
from ...task.writer import write_scenario
from .judged import criteria_of

MODULES: Final = ("plant", "controller")
DIGITS: Final = 12  # of a spline's derivatives after the point; those of far rows are 0
MODEL: Final = "scene.mjb"  # the plant's, which the page compiles


def refuse_outside(prepared: Prepared) -> None:
    """Refuse what a page cannot simulate, by its name."""
    scenario, assembly = prepared.scenario, prepared.assembly
    rules: dict[str, object] = {f"{p.name} {_foreign(p)}": _foreign(p) for p in assembly.parts}
    rules |= {
        "a system without a trajectory": scenario.is_system,
        f"coupling = {scenario.coupling!r}": scenario.coupling not in SWITCHED,
        "[steps]": scenario.steps,
        "[inputs]": assembly.driven,
        "input_scale": scenario.input_scale != 1.0,
        "the column until": any(row.until for row in scenario.rows),
        "a client": scenario.client is not None,
    }
    no = "a page cannot simulate; `live` without --page runs it"
    check_rules({f"--page: {name}, which {no}": broken for name, broken in rules.items()})


def _foreign(part: Part) -> str:
    """Why a part has no module; "" if it has one."""
    is_own, suffix = part.file is None, part.file.suffix if part.file else ""
    if suffix == ".py" or (is_own and part.target.kind_of(part.name) != "native"):
        return "runs Python code"
    is_plant = part.name == "plant" and part.is_model
    return "" if is_plant or (is_own and part.name in MODULES) else "is not of our C code"


def engine_of(session: Session) -> dict[str, object]:
    """Return what the page's worker is given, as `SystemData` and `SimulationData` in engine/."""
    scenario, assembly, rows = session.scenario, session.prepared.assembly, session.table.rows
    columns, path = list(session.numbers()), session.trajectory
    plain = {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in asdict(path).items()}
    plain |= {"turns": turns(path.orientations).tolist(), "influence": _influence(path)}
    commands = [f"controller.{name}" for name in (*COMMANDS, *POSTURE_COMMANDS)]
    turn = session.start_pose.grasp_yaw if scenario.align else 0.0
    forces = {body: [columns.index(f"plant.{FORCES[body]}[{i}]") for i in (1, 2, 3)]
              for body in scenario.pushed}  # fmt: skip
    return {
        "slaves": [_slave(session, part, columns) for part in assembly.parts],
        "coupling": scenario.coupling,
        "step": scenario.step,
        "ticks": scenario.ticks,
        "external": session.row()[1 : 1 + len(assembly.external)].tolist(),
        "trajectory": plain,
        "commands": [columns.index(name) if name in columns else -1 for name in commands],
        "pushes": [{**asdict(push), "columns": forces[push.on]} for push in scenario.push],
        "offsets": [[*row.position, turn * (row.frame == "target")] for row in rows],
        "moves": scenario.timing == "table",
        "criteria": list(criteria_of(session)),
        "head": session.head.model_copy(update={"kind": "native"}).model_dump(),
        "files": dict(_files(scenario)),
    }


def _influence(path: Trajectory) -> list[object]:
    """What each row's value adds to velocity and acceleration at each row of a spline (2, n, n)."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow, and rarely needed

    n = len(path.times)
    if path.interpolation != "spline" or n == 1:
        return []
    at_rest = [(order, np.zeros(n)) for order in (1, 2)]
    spline = make_interp_spline(path.times, np.eye(n), k=5, bc_type=(at_rest, at_rest))
    return [spline(path.times, order).round(DIGITS).tolist() for order in (1, 2)]


def _slave(session: Session, part: Part, columns: list[str]) -> dict[str, object]:
    """Return a slave, as `SlaveData` in engine/slave.ts."""
    assembly, name = session.prepared.assembly, part.name
    fmu = part.source or own_fmu(name)
    at = {scalar.name: scalar.value_reference for scalar in fmu.interface.scalars()}
    fed = [(at[n], f"{name}.{n}", *PLAIN) for i, n in assembly.external if i == name]
    wires = [each for each in assembly.connections if each.target[0] == name]
    fed += [(at[it.target[1]], ".".join(it.source), it.factor, it.offset) for it in wires]
    return {
        "name": name,
        "token": fmu.token,
        "table": _table(fmu, session.parameters[name]),
        "models": _models(session.scenario, part),
        "feeds": [(i, columns.index(column), *linear) for i, column, *linear in fed],
        "outputs": [(at[n], columns.index(f"{name}.{n}")) for n in assembly.outputs[name]],
    }


def _table(fmu: NativeFmu, values: Mapping[str, Value]) -> str:
    """Return an FMU's table, with start values, and with the one model that they choose."""
    started = tuple(_started(variable, values) for variable in fmu.interface.variables)
    options = dict.fromkeys((key, MODEL if key == "model" else text) for key, text in fmu.options)
    interface = replace(fmu.interface, variables=started)
    return table(interface, fmu.token, fmu.step_size, [*options], scalars=True).decode()


def _started(variable: Variable, values: Mapping[str, Value]) -> Variable:
    start = [values[name] for name in variable.names() if name in values]
    if variable.source == "scene":  # there is one
        return replace(variable, start=variable.choices[0])
    if variable.causality != "parameter" or not start:
        return variable
    return replace(variable, start=tuple(map(float, start)) if variable.shape else start[0])


def _models(scenario: Scenario, part: Part) -> dict[str, str]:
    """Return the MJCF of an FMU's models by the names of its resources."""
    if part.name == "controller":
        specs = {f"{robot}.mjb": arm_spec(robot=robot) for robot in ROBOTS}
        return {name: written(spec, spec.compile()) for name, spec in specs.items()}
    if part.file is not None:
        return {MODEL: mjcf_of(part.file, scenario.robot)}
    parameters = PlantParameters(scene=scenario.scene, robot=scenario.robot)
    return {MODEL: written(*compiled_scene(parameters))}


def _files(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the scenario's files, for the journal."""
    with temporary_folder(cache_folder()) as folder:
        write_scenario(scenario, folder)
        own = [scenario.folder / text for text in scenario.fmus.values()] if scenario.folder else []
        beside = [path.with_suffix(suffix) for path in own for suffix in (path.suffix, ".toml")]
        for path in (*sorted(folder.iterdir()), *filter(Path.is_file, beside)):
            yield path.name, path.read_text(encoding="utf-8")
