"""`panda-cosim bench`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.table import Table

from ...fmus.atomic import check_replaceable, write_whole
from ...fmus.sources.targets import Kind
from ...study.benchmark import LABELS, RATIOS, BenchResult, bench
from ...task.files import marked_json
from ..common import KIND, OVERWRITE, announce_python
from ..console import show, table, tell
from ..forms import option


def command(
    kind: Kind = KIND, json: Path | None = option("--json FILE"), overwrite: bool = OVERWRITE
) -> None:
    """Measure what a co-simulation step costs.

    Compares our master's step with MuJoCo alone, stepping the scene as it is drawn and the model
    that the FMU steps, and with a plain FMPy loop over the same FMUs. Takes a minute or two.

    ```
    panda-cosim bench
    panda-cosim bench --kind python --json bench.json
    ```

    Args:
        json: Also write the numbers to this file.
    """
    check_replaceable(json, overwrite=overwrite)
    tell("Measuring; do not use the machine meanwhile ...")
    announce_python(kind)
    result = bench(kind=kind)
    for item in tables(result):
        show(item)
    if json is not None:
        write_whole(json, marked_json(result.to_json()))
        show(str(json))


def tables(result: BenchResult) -> Iterator[Table | str]:
    """Yield what is shown of a result."""
    columns = ("median", "quartiles")
    steps = [(LABELS[way], *cost.texts(1)) for way, cost in result.steps.items()]
    title = f"Cost of a step of {result.scenario} [us]"
    yield table(("way*", *columns), steps, right=columns, title=title)
    yield f"(c) runs at {result.real_time_factor:.1f} times real time\n"
    ratios = [(name, *r.texts(2), RATIOS[name][2]) for name, r in result.ratios.items()]
    heads = ("ratio", *columns, "goal*")
    yield table(heads, ratios, right=columns, title="Ratios, measured in turns")
    commands = [(what, f"{seconds:.2f} s") for what, seconds in result.start_up.items()]
    yield table(("command*", "best of 7"), commands, right=("best of 7",), title="Whole commands")
    yield ", ".join(f"{key} {value}" for key, value in result.machine.items())
