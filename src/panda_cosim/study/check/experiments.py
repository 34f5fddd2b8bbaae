"""Reference experiments inside FMUs: written into those that we build, and run by `check`.

Each is run as a scenario of that one FMU. The format is FMI-LS-REF 1.0.0-beta.1, with experiments
as MA-HS-Experiments describes them. Both still move, so that nothing else knows them.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ...fmus.atomic import replacing
from ...fmus.build.description import literal, render
from ...fmus.build.native import add_members
from ...fmus.build.ssp import Component, parameter_set
from ...fmus.errors import InputError
from ...fmus.interface.tables import Connection
from ...fmus.interface.variables import Value, by_array
from ...fmus.master.fmu_file import TEXTS, Fmu, read_fmu, read_value
from ...fmus.master.system import in_units, multiples_of, read_fmus
from ...fmus.master.wiring import Name
from ...fmus.reading import file_inside, finite_number, read_xml
from ...result.judging.advice import Level
from ...result.recording import Recording
from ...run.execution import Execution
from ...run.options import Options
from ...run.prepare import prepare
from ...run.stopping import StopRequest
from ...task.criteria import SignalCriterion, Success
from ...task.files import as_argument, check_new
from ...task.input_table import InputTable
from ...task.scenario import SCENARIO_FILE, Scenario
from ...task.writer import check_name, write_scenario
from ..compare.tubes import distances
from .diagnosis import rehearse

Array = NDArray[np.float64]
Series = dict[str, Array]  # scalar variables over time (n,), after "time" [s]

FOLDER: Final = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST: Final = "fmi-ls-manifest.xml"
TOLERANCE: Final = 1e-6  # of an experiment that names none, relative to values above 1
# Of what is written: more values of a stimulus are thinned; rows of references.
MOST_CELLS, MOST_REFERENCES = 60_000, 200
MOST_COMPARED: Final = 10  # outputs, as the cross-check rules recommend
_ON_TICK: Final = 1e-6  # of a step, by which a reference may be off an instant
_SWITCHES: Final = {"true": "1", "false": "0"}
_IT: Final = "fmu"  # the instance


@dataclass(frozen=True)
class Experiment:
    """What an FMU is driven with, and what it should answer."""

    name: str
    start: float  # [s]
    stop: float
    step: float
    tolerance: float = TOLERANCE
    description: str = "The default experiment; inputs keep their start values"
    parameters: Mapping[str, Value] = field(default_factory=dict)  # by scalar variable
    stimuli: Series = field(default_factory=dict)
    references: Series = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Communication steps."""
        return round((self.stop - self.start) / self.step)

    def compared(self) -> tuple[Any, Any]:
        """Rows of the references that are at an instant, and their instants' numbers."""
        ticks = (self.references.get("time", np.zeros(0)) - self.start) / self.step
        nearest = np.rint(ticks).astype(int)
        is_instant = np.abs(ticks - nearest) <= _ON_TICK
        rows = np.flatnonzero(is_instant & (nearest >= 0) & (nearest <= self.steps))
        return rows, nearest[rows]


@dataclass(frozen=True)
class Outcome:
    """How far an FMU is from the references of an experiment."""

    experiment: str
    tolerance: float
    values: int = 0  # that were compared
    left_out: int = 0  # that were not, as they are at no instant of the run
    largest_difference: float = math.nan  # relative to reference values above 1
    variable: str = ""
    time: float = math.nan  # [s]

    @property
    def ok(self) -> bool:
        """Whether something was compared, and all of it is within the tolerance."""
        return self.largest_difference <= self.tolerance

    @property
    def level(self) -> Level:
        """What `check` calls it: good only if nothing was left out."""
        return "wrong" if not self.ok else "hint" if self.left_out else "good"

    def __str__(self) -> str:
        left = f"{self.left_out} more at no instant of the run" if self.left_out else ""
        if not self.values:
            return f"{self.experiment}: nothing could be compared" + (left and f", {left}")
        largest = f"{self.largest_difference:.3g} ({self.variable} at t = {self.time:g} s)"
        return (
            f"{self.experiment}: {self.values} values, largest difference {largest}, tolerance "
            f"{self.tolerance:g}" + (left and f"; {left}, not compared")
        )


# Run.


def check_experiments(path: Path) -> list[Outcome]:
    """Run the experiments that are in an FMU; none if there are none."""
    fmu = read_fmu(path)
    return [_outcome(fmu, experiment) for experiment in _experiments(fmu)]


def _outcome(fmu: Fmu, experiment: Experiment) -> Outcome:
    times, *expected = experiment.references.values() or [np.zeros(0)]
    names, (rows, ticks) = list(experiment.references)[1:], experiment.compared()
    left_out = (len(times) - rows.size) * len(names)
    if not rows.size or not expected:
        return Outcome(experiment.name, experiment.tolerance, left_out=left_out)
    recording, columns = _run(fmu, experiment), []
    for name, reference in zip(names, (values[rows] for values in expected), strict=True):
        answers = recording[f"{_IT}.{name}"][ticks]
        is_text = reference.dtype == object
        if is_text:  # bytes as in the file
            answers = np.array([a if isinstance(a, str) else a.hex() for a in answers], object)
        apart = distances(answers, np.arange(rows.size), reference, 0.0, 0)
        columns.append(apart if is_text else apart / np.maximum(np.abs(reference), 1.0))
    errors = np.stack(columns, axis=1)
    row, column = divmod(int(errors.argmax()), errors.shape[1])
    return Outcome(experiment.name, experiment.tolerance, errors.size, left_out,
                   float(errors[row, column]), names[column], float(times[rows[row]]))  # fmt: skip


def _run(fmu: Fmu, experiment: Experiment) -> Recording:
    """Run an experiment in memory."""
    prepared = prepare(_scenario(fmu, experiment))
    assembly = replace(prepared.assembly, start_time=experiment.start)
    with Execution(replace(prepared, assembly=assembly), writes=False) as execution:
        execution.advance(execution.ticks, StopRequest())
        return execution.close().recording


def _scenario(fmu: Fmu, experiment: Experiment) -> Scenario:
    """Return the scenario that drives an FMU as an experiment does, but begins at 0."""
    given = {n: v for n, v in experiment.parameters.items() if n not in experiment.stimuli}
    inputs = {n for n in given if fmu.variable(n).variable.causality == "input"}
    table, driven = InputTable(), dict(experiment.stimuli)
    if driven:
        times = tuple(driven.pop("time").tolist())
        texts = {f"{_IT}.{n}": tuple(literal(fmu.variables[n], value) for value in values.tolist())
                 for n, values in driven.items()}  # fmt: skip
        table = InputTable(times, texts, fmu.label)
    return Scenario(
        name=_IT, table=None, duration=experiment.steps * experiment.step,
        step=experiment.step, fmus={_IT: str(fmu.path.absolute())},
        inputs={f"{_IT}.{name}": given[name] for name in inputs},
        input_table=table,
        parameters={_IT: {n: v for n, v in given.items() if n not in inputs}},
    )  # fmt: skip


def import_experiment(path: Path, folder: Path) -> tuple[list[Path], str]:
    """Make a scenario of the first experiment in an FMU; returns its files, and what judges it."""
    # Its references at the end, or at the last instant for which there are some.
    check_name(folder)
    fmu = read_fmu(path)
    experiment = _first(fmu)
    if experiment.start != 0.0:
        raise InputError(f"{path}: startTime {experiment.start:g} of its experiment; must be 0")
    criteria, values = [], list(experiment.references.items())[1:]
    rows, ticks = experiment.compared()
    numbers = [(n, each[rows[-1]]) for n, each in values if rows.size and each.dtype != object]
    judged = [(name, float(value)) for name, value in numbers if np.isfinite(value)]
    for name, value in judged[:MOST_COMPARED]:
        bound = experiment.tolerance * max(abs(value), 1.0)
        end = "end" if ticks[-1] == experiment.steps else float(ticks[-1] * experiment.step)
        signal, above, below = f"{_IT}.{name}", value - bound, value + bound
        criteria.append(SignalCriterion(signal, "final", to=end, above=above, below=below))
    scenario = replace(
        _scenario(fmu, experiment),
        name=folder.name,
        purpose=f"Experiment of {path.name}",
        fmus={_IT: path.name},
        success=Success(signal=tuple(criteria)),
    )
    check_new([folder / path.name])
    write_scenario(scenario, folder)
    shutil.copy(path, folder / path.name)
    total = sum(each.size for _, each in values)
    more = f"panda-cosim check {as_argument(path)} compares the rest"
    if not criteria:
        more = f"add [[success.signal]] to {folder / SCENARIO_FILE}, or every run is a success"
    about = f"{len(criteria)} of {total} reference values, at most one of an output; {more}"
    return sorted(folder.iterdir()), f"Criteria: {about}"


# Read.


def _experiments(fmu: Fmu) -> list[Experiment]:
    """Experiments of an FMU; if it only has results, these are of its default experiment."""
    manifest = fmu.folder / FOLDER / MANIFEST
    found: dict[str, list[Experiment]] = {"experiment": [], "result": []}
    for related in _read(fmu, manifest).iter("Related") if manifest.is_file() else ():
        role, source = related.get("role", "").partition("/")[0], related.get("source", "")
        if role == "experiment":
            found[role] += _listed(fmu, _member(fmu, manifest, source))
        elif role == "result" and source.endswith(".csv"):
            references = _series(fmu, _member(fmu, manifest, source))
            found[role].append(_experiment(fmu, source, {}, references=references))
    return found["experiment"] or found["result"]


def _first(fmu: Fmu) -> Experiment:
    for experiment in _experiments(fmu):
        return experiment
    raise InputError(f"{fmu.label}: holds no experiments")


def _listed(fmu: Fmu, file: Path) -> Iterator[Experiment]:
    for element in _read(fmu, file).iter("Experiment"):
        parts = {part.tag: part.get("source", "") for part in element if part.get("source")}
        files = {tag: _member(fmu, file, source) for tag, source in parts.items()}
        series = {n: _series(fmu, files[n]) for n in ("Stimuli", "References") if n in files}
        settings = {**element.attrib}
        for transient in element.iter("TransientSimulation"):  # where the newest draft has them
            settings |= transient.attrib
        values = _parameters(fmu, files["Parameters"]) if "Parameters" in files else {}
        yield replace(
            _experiment(fmu, element.get("name", ""), settings, series.get("References", {})),
            parameters=values, stimuli=series.get("Stimuli", {}),
        )  # fmt: skip


def _experiment(fmu: Fmu, name: str, settings: Mapping[str, str], references: Series) -> Experiment:
    """Return an experiment; what it does not set, the FMU's default experiment does."""
    default, times = fmu.description.defaultExperiment, references.get("time", np.zeros(0))
    spacing = float(np.diff(times).min()) if len(times) > 1 else 0.001
    last = float(times[-1]) if len(times) else 1.0
    numbers = {"startTime": 0.0, "stopTime": last, "stepSize": spacing}
    texts = {key: getattr(default, key, None) or str(n) for key, n in numbers.items()}
    texts["tolerance"] = str(TOLERANCE)  # not the default experiment's, which is its solver's
    for key, text in {**texts, **{k: settings[k] for k in texts if k in settings}}.items():
        number = finite_number(text)
        bound = " above 0" if key in ("stepSize", "tolerance") else ""
        if number is None or (bound and number <= 0.0):
            place = f"{fmu.label}: experiment {name!r}"
            raise InputError(f"{place}: {key} {text!r}; must be a finite number{bound}")
        numbers[key] = number
    start, stop, step, tolerance = numbers.values()
    return Experiment(name, start, stop, step, tolerance, references=references)


def _read(fmu: Fmu, file: Path) -> Element:
    return read_xml(file, f"{fmu.label}: {file.name}")


def _member(fmu: Fmu, file: Path, source: str) -> Path:
    return file_inside(file.parent, source, fmu.folder, fmu.label)


def _series(fmu: Fmu, file: Path) -> Series:
    """Read a CSV; a cell of an array has all its elements, bytes are hexadecimal digits."""
    arrays, place = by_array(fmu.variables.values()), f"{fmu.label}: {file.name}"
    table = InputTable.read(file, place)
    series = {"time": np.array(table.times)}
    for name, cells in table.columns.items():
        scalars = arrays.get(name) or [fmu.variable(name)]
        kind = scalars[0].variable.kind
        rows = [cell.split() if len(scalars) > 1 else [cell.strip()] for cell in cells]
        try:
            parts = [[_cell(kind, word) for word in row] for row in rows]
            values = np.array(parts, object if kind in TEXTS else float)
            values = values.reshape(len(rows), len(scalars))
        except ValueError as error:
            what = "text" if kind in TEXTS else "number"
            what = f"{len(scalars)} {what}s" if len(scalars) > 1 else f"a {what}"
            raise InputError(f"{place}: {name}: must have {what} in each row") from error
        series |= zip((scalar.name for scalar in scalars), values.T, strict=True)
    return series


def _cell(kind: str, word: str) -> float | str:
    if kind in TEXTS:
        return word.lower() if kind == "Binary" else word
    return float(_SWITCHES.get(word, word))


def _parameters(fmu: Fmu, file: Path) -> dict[str, Value]:
    """Read a parameter set (SSV); one of an array has all its elements."""
    values: dict[str, Value] = {}
    arrays = by_array(fmu.variables.values())
    for parameter in _read(fmu, file).iterfind(".//{*}Parameter"):
        name = parameter.get("name", "")
        scalars = arrays.get(name) or [fmu.variable(name)]
        text = parameter[0].get("value", "") if len(parameter) else ""
        texts = text.split() if len(scalars) > 1 else [text]
        place = f"{fmu.label}: {file.name}: {name}"
        if len(texts) != len(scalars):
            raise InputError(f"{place}: {len(texts)} values; must be {len(scalars)}")
        for scalar, each in zip(scalars, texts, strict=True):
            values[scalar.name] = read_value(f"{place} =", scalar.variable, each)
    return values


# Write.


def experiments_of(scenario: Scenario) -> dict[str, Experiment]:
    """Run a scenario in memory; by instance, what drives each FMU as it was driven there."""
    prepared = prepare(scenario, Options())
    recording, assembly = rehearse(prepared).recording, prepared.assembly
    fmus = read_fmus(assembly.system, prepared.start_values(), scenario.coupling)
    multiples = multiples_of(fmus, assembly.system, scenario.step)
    fed: dict[Name, Array] = {}
    for each in (*(Connection(name, name) for name in assembly.external), *assembly.connections):
        if assembly.scalars[each.target].variable.kind not in TEXTS:
            values, linear = recording[".".join(each.source)], in_units(fmus, each)
            if scenario.coupling == "iterated" and each.source != each.target:
                values = np.append(values[1:], values[-1:])  # each step has the inputs of its end
            fed[each.target] = linear.factor * values + linear.offset
    experiments = {}
    for instance, interface in assembly.interfaces.items():
        driven = {name: values for (owner, name), values in fed.items() if owner == instance}
        every = math.ceil(recording.rows * len(driven) / MOST_CELLS) or 1
        rows = np.unique([*range(0, recording.rows, every), recording.rows - 1])
        stimuli = {
            name: column[rows] for name, column in {"time": recording.time, **driven}.items()
        }
        starts = {s.name: s.start for s in interface.scalars()}
        given = prepared.start_values().get(instance, {})
        experiments[instance] = Experiment(
            scenario.name, recording.time[0], recording.time[-1],
            scenario.step * multiples.get(instance, 1),
            description=f"{interface.model} as driven in the scenario {scenario.name}",
            parameters={n: v for n, v in given.items() if v != starts[n] and n not in driven},
            stimuli=stimuli if driven else {},
        )  # fmt: skip
    return experiments


def add_experiment(path: Path, experiment: Experiment | None = None) -> Experiment:
    """Put an experiment into a new FMU's file, with what the FMU answers now as references."""
    # Without one, it is the FMU's default experiment. An FMU that holds some keeps these.
    fmu = read_fmu(path)
    if (fmu.folder / FOLDER / MANIFEST).is_file():
        return _first(fmu)
    driven = experiment or _experiment(fmu, "default", {}, {})
    recording = _run(fmu, driven)
    outputs = [s for s in fmu.variables.values() if s.variable.causality == "output"]
    names = [scalar.name for scalar in outputs if scalar.variable.kind not in TEXTS]
    every = math.ceil(recording.rows / MOST_REFERENCES)
    answers = {name: recording[f"{_IT}.{name}"][::every] for name in names}
    whole = replace(driven, references={"time": recording.time[::every], **answers})
    files = {
        MANIFEST: render("experiment.manifest.j2", it=whole),
        "reference.exp": render("experiment.exp.j2", it=whole),
        "references.csv": csv_text(fmu, whole.references),
    }
    if whole.parameters:
        component = Component(path, path.name, fmu.fmi, fmu.variables, fmu.units, whole.parameters)
        files["parameters.ssv"] = parameter_set(whole.name, component)
    if whole.stimuli:
        files["stimuli.csv"] = csv_text(fmu, whole.stimuli)
    with path.open("r+b") as file:
        add_members(file, {f"{FOLDER}/{name}": content for name, content in files.items()})
    return whole


def csv_text(fmu: Fmu, series: Series) -> bytes:
    """Format values as CSV, by the FMU's own names; an array of FMI 3.0 is one column."""
    # Its elements that have no values keep their start value.
    arrays, times = by_array(fmu.variables.values()), series["time"]
    columns = {"time": map(repr, times.tolist())}
    for array in dict.fromkeys(fmu.variables[name].variable.name for name in list(series)[1:]):
        values = ((s, series.get(s.name, np.full(len(times), s.start))) for s in arrays[array])
        texts = [[literal(scalar, value) for value in each.tolist()] for scalar, each in values]
        columns[array] = map(" ".join, zip(*texts, strict=True))
    head = ",".join(f'"{name}"' for name in columns)
    lines = [head, *map(",".join, zip(*columns.values(), strict=True)), ""]
    return "\n".join(lines).encode()


def write_compatibility(path: Path, experiment: Experiment) -> None:
    """Write a folder with an FMU and the files that the FMI cross-check rules ask for."""
    fmu, name = read_fmu(path), path.stem
    owner = {n: fmu.variables[n].variable.name for n in experiment.references if n != "time"}
    first = [*dict.fromkeys(owner.values())][:MOST_COMPARED]  # whole arrays
    compared = {n: v for n, v in experiment.references.items() if n == "time" or owner[n] in first}
    texts = {"it": experiment, "model": name, "about": fmu.description}
    files = {
        f"{name}.fmu": path.read_bytes(),
        f"{name}_ref.csv": csv_text(fmu, compared),
        f"{name}_ref.opt": render("experiment.opt.j2", it=experiment),
        "ReadMe.txt": render("experiment.txt.j2", **texts),
    }
    if experiment.stimuli:
        files[f"{name}_in.csv"] = csv_text(fmu, experiment.stimuli)
    for member, content in files.items():
        with replacing(path.with_suffix("") / member) as partial:
            partial.write_bytes(content)
