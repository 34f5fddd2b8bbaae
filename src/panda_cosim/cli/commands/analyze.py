"""`panda-cosim analyze`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from itertools import chain, product
from pathlib import Path
from textwrap import fill
from threading import Thread

import numpy as np
from pydantic_core import to_json

from ...fmus.atomic import MARK, check_replaceable, replacing, write_whole
from ...result.pictures.plot import own_style
from ...study.analysis.confirm import REFUTED
from ...study.analysis.loops import Analysis, analyze
from ...study.analysis.margins import HEADS, shown
from ...study.analysis.plot import draw_analyses
from ...task.files import marked_json
from ...task.scenario import Scenario, load_scenario
from ...task.values import Values
from ..common import (
    CONTROLLER,
    DEFAULT_SCENARIO,
    JSON,
    OVERWRITE,
    PLANT,
    SETTINGS,
    end,
    find_scenario,
    values_of,
)
from ..console import Item, show_result, table, tell, warn
from ..forms import argument, flag, option

LEFT_OUT = "larger signals, at which limits are met or contacts change; noise; other poses"
NUMBERS_FILE, PLOT_FILE, MODEL_FILE = "analysis.json", "loops.png", "analysis.npz"
_NEXT_KEY = re.compile(r",(?=[^,=]+=)")


def command(  # noqa: PLR0913 - one for each option
    cases: list[str] | None = argument("[CASE]...", None),
    at: str = option("--at TIME", "start"),
    loop: str = option("--loop INPUT", ""),
    period: str = option("--period LIST", ""),
    coupling: str = option("--coupling LIST", ""),
    verify: bool = flag("--verify"),
    out: Path = option("--out -o DIR", Path("runs/analysis")),
    assignments: list[str] | None = SETTINGS,
    controller: str | None = CONTROLLER,
    plant: str | None = PLANT,
    json: bool = JSON,
    overwrite: bool = OVERWRITE,
) -> None:
    """Measure the control loops: margins, Bode and Nichols plots, a state-space model.

    Takes any scenario whose FMUs can save and restore their state (canGetAndSetFMUState). Small
    pulses are added to each servo target, or torque, at one instant of the run, which continues.
    First come the delay and the gain that all loops bear alike, then the disk margin, by which each
    may vary in its own way, at the same time; then those of each joint, while the others stay as
    they are. Several cases are overlaid in loops.png; the folder also gets analysis.json, and the
    first case's model in analysis.npz.

    ```
    panda-cosim analyze
    panda-cosim analyze payload --at grasp --out runs/analysis
    panda-cosim analyze controller.kp=8 controller.kp=12,controller.kd=0.1 --verify
    panda-cosim analyze --set mismatch.delay=0.003 --period 0.001,0.002 --coupling jacobi
    panda-cosim analyze pick_and_place my_law.py:A my_law.py:B --set scene=motors --at 2.3
    ```

    Args:
        cases: Scenarios; each may be followed by other cases of it: a law, LAW.py:CLASS, or values,
            KEY=VALUE[,KEY=VALUE]. Default: pick_and_place.
        at: Instant of the run: seconds, or an event, as grasp or 'release + 0.5'.
        loop: Input at which the loops are opened. Default: those of the plant that an FMU feeds.
        period: Periods of the controller [s], separated by commas. Default: the scenario's.
        coupling: Likewise gauss-seidel, jacobi.
        verify: Run with changes just within and just beyond each margin.
        out: Folder for the results.
    """
    chosen = _cases(cases, values_of(assignments, controller, plant), period, coupling)
    files = [out / name for name in (NUMBERS_FILE, PLOT_FILE, MODEL_FILE)]
    check_replaceable(*files, overwrite=overwrite)
    tell("Measuring the loops ...")
    Thread(target=import_module, args=("control",), daemon=True).start()  # 1 s, while FMUs step
    found = {name: analyze(each, at, loop=loop, verify=verify) for name, each in chosen.items()}
    remarks = [f"{name}: {text}" for name, each in found.items() for text in each.remarks]
    content = {**_described(found), "folder": out, "remarks": remarks}
    _write(files, found, content)
    for remark in remarks:
        warn(remark)
    items = chain.from_iterable(_shown(name, analysis) for name, analysis in found.items())
    rest = (fill(f"Not in these margins: {LEFT_OUT}.", 79), "", *map(str, files))
    show_result(content, chain(items, rest), json=json)
    end(missed=any(it.verdict == REFUTED for a in found.values() for it in a.confirmed))


def _described(found: Mapping[str, Analysis]) -> dict[str, object]:
    """Return plain values of all cases, with the first one's model."""
    first, *_ = analyses = [*found.values()]
    return {
        "scenario": first.scenario, "at": first.at, "left_out": LEFT_OUT, "cases": [*found],
        "variants": [each.margins for each in analyses],
        "confirmed": [each.confirmed for each in analyses],
        "model": {name: np.asarray(value).tolist() for name, value in first.matrices.items()},
    }  # fmt: skip


def _write(files: list[Path], found: Mapping[str, Analysis], content: object) -> None:
    """Write the numbers, the plots of all cases, and the first one's model."""
    first = next(iter(found.values()))
    write_whole(files[0], marked_json(to_json(content, inf_nan_mode="null").decode()))
    with own_style(), replacing(files[1]) as path:  # without `save`, which takes 0.2 s to pack it
        draw_analyses(found).savefig(path, format="png", metadata={"Comment": MARK})
    with replacing(files[2]) as path:
        np.savez(path, note=np.bytes_(MARK), allow_pickle=False, **first.matrices)


def _cases(words: list[str] | None, common: Values, *lists: str) -> dict[str, Scenario]:
    """Scenarios by name: those of the words, with each period and coupling of the lists."""
    keys = ("controller.period", "coupling")
    each = [[f"{key}={value.strip()}" for value in text.split(",")]
            for key, text in zip(keys, lists, strict=True) if text]  # fmt: skip
    found, scenario = {}, load_scenario(DEFAULT_SCENARIO)
    for word in words or [DEFAULT_SCENARIO]:
        values = _values(word)
        scenario = scenario if values else find_scenario(word)
        for more in product(*each):
            changed = scenario.changed({**common, **values, **values_of(more)})
            found[" ".join((word, *more))] = changed
    return found


def _values(case: str) -> Values:
    """Return the values by which a case differs from the scenario; of a scenario's name, none."""
    if "=" in case:
        return values_of(_NEXT_KEY.split(case))
    return {"fmus.controller": case} if re.search(r"\.py:|\.fmu$", case) else {}


def _shown(name: str, analysis: Analysis) -> Iterator[Item]:
    """Yield what the loops bear, and what runs with more and less came to."""
    yield f"{name} at t = {analysis.at:g} s; loops opened at"
    for line in (", ".join(analysis.inputs), "", *analysis.margins.lines, ""):
        yield fill(line, 79)
    if analysis.margins.loops:
        title = "One loop, while the others stay as they are"
        yield table(tuple(HEADS), analysis.margins.rows, right=tuple(HEADS), title=title)
        yield ""
    if analysis.confirmed:
        rows = [
            [e.margin, e.input or "all", *map(shown, (e.within, e.value, e.beyond)), e.verdict]
            for e in analysis.confirmed
        ]
        heads = ("margin", "loop", "stable at", "margin is", "unstable at", "runs say")
        yield table(heads, rows, right=heads[2:5], title="Runs on both sides of each margin")
        yield ""
