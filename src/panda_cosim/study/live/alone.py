"""What a page needs to simulate a prepared run by itself, in show/view/source/src/engine.

The page has plant and controller of `fmus/native` as modules, and MuJoCo in its own version. Here
are their tables of variables, with the scenario's start values, their models as MJCF, how they are
connected, and the inputs that the scenario gives. What else a scenario can have is refused by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from ...assets.arm import written
from ...assets.franka import ROBOTS
from ...controller.model import arm_spec
from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.build.native import NativeFmu, table
from ...fmus.interface.plant import FORCES
from ...fmus.interface.units import PLAIN
from ...fmus.interface.variables import Interface, Value, Variable
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
from ...task.trajectory import COMMANDS, POSTURE_COMMANDS, turns
from ...task.writer import write_scenario

MODULES: Final = ("plant", "controller")
MODEL: Final = "scene.mjb"  # the plant's, which the page compiles


def engine_of(session: Session) -> dict[str, object]:
    """Return what the page's worker is given, as `SimulationData` in engine/simulation.ts."""
    scenario, assembly = session.scenario, session.prepared.assembly
    columns = list(session.numbers())
    external = [columns.index(".".join(name)) for name in assembly.external]
    parameters = session.parameters
    values = {f"{i}.{name}": value for i, own in parameters.items() for name, value in own.items()}
    return {
        "slaves": [_slave(session, part, columns) for part in assembly.parts],
        "parameters": {
            name: {
                "slave": name.partition(".")[0],
                "reference": scalar.value_reference,
                "kind": scalar.variable.kind,
            }
            for name, scalar in session.tunables.items()
        },
        "values": {name: values[name] for name in session.tunables},
        "coupling": scenario.coupling,
        "step": scenario.step,
        "ticks": scenario.ticks,
        "columns": columns,
        "external": session.row()[1 : 1 + len(external)].tolist(),
        **_commands(session, columns),
        "head": session.head.model_copy(update={"kind": "native"}).model_dump(),
        "files": dict(_files(scenario)),
    }


def refuse_outside(prepared: Prepared) -> None:
    """Refuse what a page cannot simulate, by its name."""
    scenario, assembly = prepared.scenario, prepared.assembly
    rules: dict[str, object] = {
        f"{part.place} {why}": why for part in assembly.parts if (why := _foreign(part))
    }
    rules |= {
        "a system without a trajectory": scenario.is_system,
        f"coupling = {scenario.coupling!r}": scenario.coupling not in SWITCHED,
        "[steps]": scenario.steps,
        "[inputs]": assembly.driven,
        "input_scale": scenario.input_scale != 1.0,
        "the column until": any(row.until for row in scenario.rows),
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


def _slave(session: Session, part: Part, columns: list[str]) -> dict[str, object]:
    """Return a slave, as `SlaveData` in engine/slave.ts."""
    assembly, values = session.prepared.assembly, session.parameters[part.name]
    fmu = part.source or own_fmu(part.name)
    references = {scalar.name: scalar.value_reference for scalar in fmu.interface.scalars()}
    feeds = {n: (f"{i}.{n}", PLAIN) for i, n in assembly.external if i == part.name}
    feeds |= {
        each.target[1]: (".".join(each.source), (each.factor, each.offset))
        for each in assembly.connections
        if each.target[0] == part.name
    }
    return {
        "name": part.name,
        "module": part.name,
        "token": fmu.token,
        "table": _table(fmu, values),
        "models": _models(session, part),
        "feeds": [
            [references[name], columns.index(column), *linear]
            for name, (column, linear) in feeds.items()
        ],
        "outputs": [
            [references[name], columns.index(f"{part.name}.{name}")]
            for name in assembly.outputs[part.name]
        ],
    }


def _table(fmu: NativeFmu, values: Mapping[str, Value]) -> str:
    """Return an FMU's table, with start values, and with the one model that they choose."""
    variables = tuple(_started(variable, values) for variable in fmu.interface.variables)
    options = [each for each in fmu.options if each[0] != "model"]
    models = [("model", MODEL)] if len(options) < len(fmu.options) else []
    interface: Interface = replace(fmu.interface, variables=variables)
    return table(interface, fmu.token, fmu.step_size, (*models, *options), scalars=True).decode()


def _started(variable: Variable, values: Mapping[str, Value]) -> Variable:
    if variable.causality != "parameter":
        return variable
    if variable.source == "scene":  # there is one
        return replace(variable, start=variable.choices[0])
    start = [values[name] for name in variable.names() if name in values]
    if not start:
        return variable
    return replace(variable, start=tuple(map(float, start)) if variable.shape else start[0])


def _models(session: Session, part: Part) -> dict[str, str]:
    """Return the MJCF of an FMU's models by the names of its resources."""
    scenario = session.scenario
    if part.name == "controller":
        specs = {f"{robot}.mjb": arm_spec(robot=robot) for robot in ROBOTS}
        return {name: written(spec, spec.compile()) for name, spec in specs.items()}
    if part.file is not None:
        return {MODEL: mjcf_of(part.file, scenario.robot)}
    parameters = PlantParameters(scene=scenario.scene, robot=scenario.robot)
    return {MODEL: written(*compiled_scene(parameters))}


def _commands(session: Session, columns: list[str]) -> dict[str, object]:
    """Return the commanded path, its rows, and the pushes."""
    scenario, path, rows = session.scenario, session.trajectory, session.table.rows
    is_timed = scenario.timing != "table"
    turn = session.start_pose.grasp_yaw if scenario.align else 0.0
    names = [f"controller.{name}" for name in (*COMMANDS, *POSTURE_COMMANDS)]
    return {
        "trajectory": {
            "times": path.times.tolist(),
            "positions": path.positions.tolist(),
            "orientations": path.orientations.tolist(),
            "turns": turns(path.orientations).tolist(),
            "grips": path.grips.tolist(),
            "postures": None if path.postures is None else path.postures.tolist(),
            "interpolation": path.interpolation,
        },
        "commands": [columns.index(name) if name in columns else -1 for name in names],
        "pushes": [
            {
                "start": push.start,
                "duration": push.duration,
                "force": list(push.force),
                "columns": [columns.index(f"plant.{FORCES[push.on]}[{i}]") for i in (1, 2, 3)],
            }
            for push in scenario.push
        ],
        "moves": f"timing = {scenario.timing!r}: waypoints cannot move here" if is_timed else "",
        "rows": [
            {
                "label": row.name or str(number),
                "position": list(row.position),
                "turn": turn if row.frame == "target" else 0.0,
            }
            for number, row in enumerate(rows, start=1)
        ],
    }


def _files(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the scenario's files, for the journal."""
    with temporary_folder(cache_folder()) as folder:
        write_scenario(scenario, folder)
        own = [scenario.folder / text for text in scenario.fmus.values()] if scenario.folder else []
        beside = [path.with_suffix(suffix) for path in own for suffix in (path.suffix, ".toml")]
        for path in (*sorted(folder.iterdir()), *filter(Path.is_file, beside)):
            yield path.name, path.read_text(encoding="utf-8")
