"""What tests of the whole co-simulation do in a process of their own."""

import io
import json
import resource
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console

from couple_support import panda_system
from master_support import all_rows
from panda_cosim.assets import STEP_SIZE
from panda_cosim.cli.commands.bench import tables
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.master.system import open_system
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.study import benchmark
from panda_cosim.task.rotations import Array
from panda_cosim.task.scenario import Scenario, load_scenario
from random_tasks import run_plain


def compare(scenario: str, coupling: str, steps: int) -> dict[str, Any]:
    """Run FMUs and plain objects, and tell in which columns of the recording they differ."""
    loaded = load_scenario(scenario).changed({"coupling": coupling, "controller.observer": True})
    loaded = replace(loaded, duration=steps * STEP_SIZE)
    first, names = over_fmus(loaded)
    again, _ = over_fmus(loaded)
    plain = run_plain(loaded)
    outputs = {f"{i}.{s.name}" for i, t in INTERFACES.items() if i != "sensors"
               for s in t.scalars() if s.variable.causality == "output"}  # fmt: skip
    differing = []
    for name, values in zip(names, first.T, strict=True):
        told = plain.time if name == "time" else plain[name]
        if coupling == "jacobi" and name in outputs and name.startswith("controller."):
            values, told = values[1:], told[:-1]  # is heard of a tick later  # noqa: PLW2901
        differing += [] if np.array_equal(values, told) else [name]
    return {
        "columns": outputs <= {*names} and len({*names}) == len(names),
        "differing": differing,
        "repeats": first.tobytes() == again.tobytes(),
        "rows": len(first),
        "moved": float(np.ptp(plain["plant.hand_xpos[3]"])),
    }


def over_fmus(scenario: Scenario) -> tuple[Array, list[str]]:
    """Rows of a run over the FMUs, and the names of their columns."""
    values = start_values(scenario)
    commands = resolve(scenario, values).sample(instants(scenario))
    asked = [f"{i}.{v.name}" for i, t in INTERFACES.items() for v in t.of("output") if v.on_request]
    with open_system(
        panda_system(asked), values, stop=scenario.duration, coupling=scenario.coupling
    ) as session:
        rows = all_rows(session.master, scenario.ticks, commands)
        names = ["time", *(".".join(column) for column in session.master.columns)]
    return rows, names


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
            session.master.begin(lambda _rows: None)
            session.master.step(count, still)
            session.master.end(still[count:])
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
