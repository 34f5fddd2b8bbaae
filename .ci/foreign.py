"""Other people's FMUs in our master, in FMPy's, and in a loop of bare calls.

Usage: FOREIGN_FMUS=FOLDER python .ci/foreign.py [--each]

Every co-simulation FMU below the folder runs a hundred steps three times, in a process of its
own. The table is by tool: what ran, what equals the bare loop, and the words where it did not
run. An FMU may end the run: what was recorded until then is compared.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from panda_cosim.result.recording import Recording

STEPS = 100
EQUAL = 1e-9  # of the largest value of the signal, or of 1
LIMIT = 120  # [s] for an FMU
HEAD = ("tool", "tried", "run", "equal to the bare loop", "equal to FMPy", "neither", "not run")
Values = dict[str, np.ndarray]


class Plan(NamedTuple):
    """What is asked of an FMU."""

    path: Path
    start: float  # [s]
    step: float  # [s]
    outputs: tuple[str, ...]  # scalars of numbers
    tool: str

    @property
    def end(self) -> float:
        """When the run ends [s]."""
        return self.start + STEPS * self.step


def plan(path: Path) -> Plan | None:
    """Read an FMU; None where it has no co-simulation."""
    description = fmpy.read_model_description(str(path), validate=False)
    if description.coSimulation is None:
        return None
    experiment = description.defaultExperiment
    start = float((experiment and experiment.startTime) or 0.0)
    stop = float((experiment and experiment.stopTime) or start + 1.0)
    fixed = description.coSimulation.fixedInternalStepSize
    own = float((experiment and experiment.stepSize) or fixed or 0.0)
    step = own if 0.0 < own * STEPS <= (stop - start) * 1.001 else (stop - start) / STEPS
    outputs = tuple(
        v.name
        for v in description.modelVariables
        if v.causality == "output" and v.type in {"Real", "Float64", "Float32"} and not v.dimensions
    )
    tool = f"{description.generationTool or 'not named'}, FMI {description.fmiVersion[0]}"
    return Plan(path, start, float(step), outputs, tool)


def ours(plan: Plan) -> Values:
    """Our master."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario"
        scenario.mkdir()
        (scenario / "scenario.toml").write_text(
            f'purpose = "a foreign FMU"\nduration = {STEPS * plan.step!r}\nstep = {plan.step!r}\n'
            f"[fmus]\nit = {json.dumps(str(plan.path))}\n"
        )
        command = [sys.executable, "-m", "panda_cosim", "run", scenario, "--no-video", "--no-view"]
        done = subprocess.run(
            [*command, "--no-plot", "--out", Path(folder) / "run"],
            capture_output=True, text=True, check=False, timeout=LIMIT,
        )  # fmt: skip
        if done.returncode not in {0, 3}:
            raise RuntimeError(done.stderr.strip().splitlines()[-1].replace(folder, "..."))
        recording = Recording.open(Path(folder) / "run")
        return {name: np.array(recording[f"it.{name}"]) for name in plan.outputs}


def fmpys(plan: Plan) -> Values:
    """FMPy's own master."""
    rows = fmpy.simulate_fmu(
        str(plan.path), validate=False, fmi_type="CoSimulation", start_time=plan.start,
        stop_time=plan.end, step_size=plan.step, output_interval=plan.step, output=plan.outputs,
    )  # fmt: skip
    return {name: rows[name] for name in plan.outputs}


def bare(plan: Plan) -> Values:
    """The calls that the standard asks for, and no more."""
    description = fmpy.read_model_description(str(plan.path), validate=False)
    folder = fmpy.extract(str(plan.path))
    references = [
        next(v.valueReference for v in description.modelVariables if v.name == name)
        for name in plan.outputs
    ]
    single = {v.name for v in description.modelVariables if v.type == "Float32"}
    tolerance = getattr(description.defaultExperiment, "tolerance", None)
    tolerance = tolerance and float(tolerance)
    common: dict[str, Any] = {
        "guid": description.guid, "unzipDirectory": folder, "instanceName": "it",
        "modelIdentifier": description.coSimulation.modelIdentifier,
    }  # fmt: skip
    if description.fmiVersion.startswith("2"):
        slave: Any = FMU2Slave(**common)
        slave.instantiate()
        slave.setupExperiment(tolerance=tolerance, startTime=plan.start)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    else:
        slave = FMU3Slave(**common)
        slave.instantiate()
        slave.enterInitializationMode(tolerance=tolerance, startTime=plan.start)
        slave.exitInitializationMode()
    rows = []
    for number in range(STEPS + 1):
        if number:
            try:
                slave.doStep(plan.start + (number - 1) * plan.step, plan.step)
            except fmpy.fmi1.FMICallException:
                break
        if description.fmiVersion.startswith("2"):
            rows.append(slave.getReal(references) if references else [])
        else:
            rows.append([
                (slave.getFloat32 if name in single else slave.getFloat64)([reference])[0]
                for name, reference in zip(plan.outputs, references, strict=True)
            ])  # fmt: skip
    shutil.rmtree(folder, ignore_errors=True)
    return dict(zip(plan.outputs, np.array(rows, float).reshape(len(rows), -1).T, strict=True))


MASTERS: dict[str, Callable[[Plan], Values]] = {"ours": ours, "fmpy": fmpys, "bare": bare}


def difference(one: Values, other: Values) -> float:
    """Return the largest difference of two runs, of the largest value of its signal or of 1."""
    largest = 0.0
    for name, expected in other.items():
        if len(one[name]) != len(expected):
            return float("inf")
        scale = max(1.0, float(np.nanmax(np.abs(expected))))
        different = np.abs(one[name] - expected) / scale
        largest = max(largest, float(np.max(np.nan_to_num(different, nan=0.0))))
    return largest


def judge(path: Path) -> dict[str, Any] | None:
    """Run an FMU in all masters; called in a process of its own."""
    asked = plan(path)
    if asked is None:
        return None
    runs: dict[str, Values] = {}
    words: dict[str, str] = {}
    for name, master in MASTERS.items():
        try:
            runs[name] = master(asked)
        except Exception as error:
            words[name] = str(error).strip() or type(error).__name__
    differences = {
        name: difference(runs["ours"], runs[name])
        for name in ("bare", "fmpy")
        if "ours" in runs and name in runs
    }
    return {"tool": asked.tool, "words": words, "differences": differences}


def results(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Judge all FMUs below a folder; a process that dies is a result, too."""
    for path in sorted(folder.rglob("*.fmu")):
        command = [sys.executable, __file__, "--judge", path]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=4 * LIMIT
            )
            lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
            word = f"ended with {done.returncode}: {done.stderr.strip()[-200:]}"
        except subprocess.TimeoutExpired:
            lines, word = [], f"took more than {4 * LIMIT} s"
        found = json.loads(lines[-1][7:]) if lines else {"tool": "?", "words": {"all": word}}
        if found is not None:
            yield str(path.relative_to(folder)), {"differences": {}, **found}


def table(folder: Path, *, each: bool = False) -> str:
    """Return the table in Markdown, with the words of what did not run below it."""
    by_tool: dict[str, list[dict[str, Any]]] = defaultdict(list)
    words = []
    for name, found in results(folder):
        by_tool[found["tool"]].append(found)
        if "ours" in found["words"] or "all" in found["words"]:
            words.append(f"- `{name}`: {found['words'].get('ours') or found['words']['all']}")
        if each:
            print(name, json.dumps(found), flush=True)
    if not by_tool:
        raise SystemExit(f"{folder}: holds no co-simulation FMU")
    rows = []
    for tool, all_found in sorted(by_tool.items()):
        ran = [
            found["differences"] for found in all_found if not {"ours", "all"} & {*found["words"]}
        ]
        equal = [{name for name, by in found.items() if by <= EQUAL} for found in ran]
        rows.append((
            tool, len(all_found), len(ran), sum("bare" in it for it in equal),
            sum("fmpy" in it for it in equal), sum(not it for it in equal),
            len(all_found) - len(ran),
        ))  # fmt: skip
    lines = [HEAD, ["---"] * len(HEAD), *rows]
    text = "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)
    return "\n\n".join((text, *(["Not run:\n\n" + "\n".join(words)] if words else [])))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--judge"]:
        print("RESULT", json.dumps(judge(Path(sys.argv[2]))))
    elif "FOREIGN_FMUS" not in os.environ:
        raise SystemExit("FOREIGN_FMUS=FOLDER must name a folder of FMUs")
    else:
        print(table(Path(os.environ["FOREIGN_FMUS"]), each="--each" in sys.argv))
