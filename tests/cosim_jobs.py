"""What tests of the whole co-simulation do in a process of their own."""

from __future__ import annotations

import io
import json
import resource
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from couple_support import panda_system
from panda_cosim.assets import STEP_SIZE
from panda_cosim.cli.commands.bench import tables
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import preset
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.master.system import open_system
from panda_cosim.plant.plant import Plant, PlantParameters
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.study import benchmark
from panda_cosim.task.scenario import load_scenario

Array = NDArray[np.float64]
MEASURED = ("hand_xpos", "hand_xquat", "jac", "qpos", "qvel", "qfrc_bias")


def compare(scenario: str, coupling: str, steps: int) -> dict[str, Any]:
    """Run FMUs and plain objects, and tell in which columns of the recording they differ."""
    first, names = over_fmus(scenario, coupling, steps)
    again, _ = over_fmus(scenario, coupling, steps)
    plain = in_a_plain_loop(scenario, coupling, steps)
    differing = [
        name for name in names if not np.array_equal(first[:, names.index(name)], plain[name])
    ]
    return {
        "columns": sorted(names) == sorted(plain),
        "differing": differing,
        "repeats": first.tobytes() == again.tobytes(),
        "rows": len(first),
        "moved": float(np.ptp(plain["plant.hand_xpos[3]"])),
    }


def over_fmus(scenario: str, coupling: str, steps: int) -> tuple[Array, list[str]]:
    """Rows of a run over the FMUs, and the names of their columns."""
    loaded = load_scenario(scenario)
    values = start_values(loaded.changed({"controller.observer": True}))
    commands = resolve(loaded, values).sample(instants(loaded))[: steps + 1]
    asked = [f"{i}.{v.name}" for i, t in INTERFACES.items() for v in t.of("output") if v.on_request]
    rows: list[Array] = []
    with open_system(
        panda_system(asked),
        values,
        stop=loaded.duration,
        coupling=coupling,  # type: ignore[arg-type]
    ) as session:
        session.master.run(steps, commands, lambda block: rows.append(block.copy()))
        names = ["time", *(".".join(column) for column in session.master.columns)]
    return np.concatenate(rows), names


def in_a_plain_loop(scenario: str, coupling: str, steps: int) -> dict[str, Array]:
    """Columns of a run of plain objects, by name."""
    loaded = load_scenario(scenario)
    commands = resolve(loaded, start_values(loaded)).sample(instants(loaded))
    plant = Plant(PlantParameters(scene=loaded.scene))
    controller = Controller(preset(loaded.gains, observer=True))
    told = controller.output_values.copy()  # what the plant hears of the controller
    rows = []
    for k in range(steps + 1):
        row = [k * STEP_SIZE, *commands[k], *plant.output_values]
        controller.input_values[: commands.shape[1]] = commands[k]
        for name in (*MEASURED, "actuator_force"):
            controller.inputs[name] = plant.outputs[name][: len(controller.inputs[name])]
        if coupling == "jacobi":
            told = controller.output_values.copy()
            controller.update()
        else:
            controller.update()
            told = controller.output_values.copy()
        plant.inputs["ctrl"] = told.view(controller.outputs.dtype)["ctrl"]
        plant.step()
        rows.append([*row, *told])
    names = ["time"]
    names += _scalars("controller", controller.inputs.dtype, 5)
    names += _scalars("plant", plant.outputs.dtype)
    names += _scalars("controller", controller.outputs.dtype)
    return dict(zip(names, np.array(rows).T, strict=True))


def _scalars(instance: str, dtype: np.dtype[Any], count: int | None = None) -> list[str]:
    """Names of the first fields' scalars."""
    names = []
    for name in (dtype.names or ())[:count]:
        shape = dtype[name].shape
        for index in product(*(range(1, n + 1) for n in shape)):
            names.append(f"{instance}.{name}" + (f"[{','.join(map(str, index))}]" if index else ""))
    return names


def memory_of_runs(steps: list[int]) -> list[float]:
    """Peak memory of this process after a run of each length [MB].

    A first run warms up, so that what comes once is in none of them.
    """
    loaded = load_scenario("pick_and_place")
    values = start_values(loaded)
    command = resolve(loaded, values).sample([0.0])
    peaks = []
    for count in [steps[0], *steps]:
        still = np.broadcast_to(command, (count + 1, command.shape[1]))
        with open_system(panda_system(), values, stop=count * STEP_SIZE) as session:
            session.master.run(count, still, lambda _rows: None)
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return peaks[1:]


def short_bench() -> dict[str, Any]:
    """Run the bench on a part of a scenario; return its JSON and what its table shows."""
    run, imports = "panda-cosim run tutorial --no-video", f'python -c "{benchmark.IMPORTS}"'
    benchmark.start_up = lambda *_: {run: [1.0, 1.2], imports: [0.5, 0.4]}
    result = benchmark.bench("tutorial", repeats=1, chunk=500)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(*tables(result), sep="\n")
    return {"json": json.loads(result.to_json()), "text": console.export_text()}
