"""Reference experiments inside FMUs: they are read, and run as a scenario of that one FMU.

The format is FMI-LS-REF 1.0.0-beta.1, with experiments as MA-HS-Experiments describes them. Both
still move, so that nothing but this and `embedding`, which writes them, knows them.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...fmus.build.description import literal
from ...fmus.errors import InputError, located, refuse
from ...fmus.interface.variables import Scalar, Value, by_array
from ...fmus.master.fmu_file import TEXTS, Fmu, read_fmu, read_value
from ...fmus.reading import file_inside, finite_number, read_xml
from ...result.judging.advice import Level
from ...result.recording import Recording
from ...result.recording.reader import cell
from ...run.execution import Execution
from ...run.prepare import prepare
from ...task.criteria import SignalCriterion, Success
from ...task.files import as_argument, check_new
from ...task.input_table import InputTable
from ...task.scenario import SCENARIO_FILE, Scenario
from ...task.writer import check_name, write_scenario

FOLDER: Final = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST: Final = "fmi-ls-manifest.xml"
TOLERANCE: Final = 1e-6  # of an experiment that names none, relative to values above 1
MOST_JUDGED: Final = 10  # outputs that a scenario of an experiment judges
_ON_TICK: Final = 1e-6  # of a step, by which a reference may be off an instant
_SWITCHES: Final = {"true": "1", "false": "0"}
IT: Final = "fmu"  # the instance
TABLES: Final = ("Stimuli", "References")  # of an experiment


@dataclass(frozen=True, eq=False)
class Series:
    """Scalar variables over time."""

    times: Array = field(default_factory=lambda: np.zeros(0))  # [s]
    values: Mapping[str, Array] = field(default_factory=dict)  # each (n,)


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
    stimuli: Series = field(default_factory=Series)
    references: Series = field(default_factory=Series)

    @property
    def steps(self) -> int:
        """Communication steps."""
        return round((self.stop - self.start) / self.step)

    def compared(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the references that are at an instant, and their instants' numbers."""
        ticks = (self.references.times - self.start) / self.step
        nearest = np.rint(ticks).astype(int)
        is_instant = np.abs(ticks - nearest) <= _ON_TICK
        rows = np.flatnonzero(is_instant & (nearest >= 0) & (nearest <= self.steps))
        return rows, nearest[rows]


@dataclass(frozen=True)
class Outcome:
    """How far an FMU is from the references of an experiment."""

    experiment: str
    tolerance: float
    values: int  # that were compared
    left_out: int  # that were not, as they are at no instant of the run
    span: str  # from the first to the last of these
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
        left = f"; {self.left_out} more not compared, {self.span}, at no instant of the run"
        largest = f"{self.largest_difference:.3g} ({self.variable} at t = {self.time:g} s)"
        compared = f"{self.values} values, largest difference {largest}, tolerance"
        said = f"{compared} {self.tolerance:g}" if self.values else "nothing could be compared"
        return f"{self.experiment}: {said}{left if self.left_out else ''}"


# Run.


def check_experiments(path: Path) -> list[Outcome]:
    """Run the experiments that are in an FMU; none if there are none."""
    fmu = read_fmu(path)
    return [_outcome(fmu, experiment) for experiment in _experiments(fmu)]


def _outcome(fmu: Fmu, experiment: Experiment) -> Outcome:
    times, references = experiment.references.times, experiment.references.values
    rows, ticks = experiment.compared()
    left, values = np.delete(times, rows), rows.size * len(references)
    span = f"t = {left.min():g} to {left.max():g} s" if left.size else ""
    left_out = left.size * len(references)
    outcome = Outcome(experiment.name, experiment.tolerance, values, left_out, span)
    if not values:
        return outcome
    recording = answer(fmu, experiment)
    apart = {n: _apart(recording[f"{IT}.{n}"][ticks], each[rows]) for n, each in references.items()}
    variable = max(apart, key=lambda name: apart[name].max())
    row, largest = rows[apart[variable].argmax()], float(apart[variable].max())
    return replace(outcome, largest_difference=largest, variable=variable, time=float(times[row]))


def _apart(answers: Array, reference: Array) -> Array:
    """How far answers (n,) are from references; texts that differ are infinitely far."""
    if reference.dtype == object:
        texts = np.array([*map(cell, answers)], object)  # as in the file
        return np.where(texts == reference, 0.0, np.inf)
    apart = np.abs(answers.astype(float) - reference) / np.maximum(np.abs(reference), 1.0)
    return np.where(np.isfinite(apart), apart, np.inf)


def answer(fmu: Fmu, experiment: Experiment) -> Recording:
    """Run an experiment in memory."""
    prepared = prepare(_scenario(fmu, experiment))
    assembly = replace(prepared.assembly, start_time=experiment.start)
    with Execution(replace(prepared, assembly=assembly), writes=False) as execution:
        execution.advance()
        return execution.close().recording


def _scenario(fmu: Fmu, experiment: Experiment) -> Scenario:
    """Return the scenario that drives an FMU as an experiment does, but begins at 0."""
    given = {n: v for n, v in experiment.parameters.items() if n not in experiment.stimuli.values}
    inputs = {n for n in given if fmu.variable(n).variable.causality == "input"}
    driven = experiment.stimuli
    texts = {f"{IT}.{n}": tuple(literal(fmu.variables[n], value) for value in values.tolist())
             for n, values in driven.values.items()}  # fmt: skip
    table = InputTable(tuple(driven.times.tolist()), texts, fmu.label) if texts else InputTable()
    return Scenario(
        name=IT, table=None, duration=experiment.steps * experiment.step,
        step=experiment.step, fmus={IT: str(fmu.path.absolute())},
        inputs={f"{IT}.{name}": given[name] for name in inputs},
        input_table=table,
        parameters={IT: {n: v for n, v in given.items() if n not in inputs}},
    )  # fmt: skip


def import_experiment(path: Path, folder: Path) -> tuple[list[Path], str]:
    """Make a scenario of the first experiment in an FMU; returns its files, and what judges it."""
    # Its references at the end, or at the last instant for which there are some.
    check_name(folder)
    fmu = read_fmu(path)
    experiment = next(iter(_experiments(fmu)), None)
    if experiment is None:
        raise InputError(f"{path}: holds no experiments")
    if experiment.start != 0.0:
        raise InputError(f"{path}: startTime {experiment.start:g} of its experiment; must be 0")
    criteria = tuple(islice(_criteria(experiment), MOST_JUDGED))
    scenario = replace(
        _scenario(fmu, experiment),
        name=folder.name,
        purpose=f"Experiment of {path.name}",
        fmus={IT: path.name},
        success=Success(signal=criteria),
    )
    check_new([folder / path.name])
    write_scenario(scenario, folder)
    shutil.copy(path, folder / path.name)
    total = sum(each.size for each in experiment.references.values.values())
    more = f"panda-cosim check {as_argument(path)} compares the rest"
    if not criteria:
        more = f"add [[success.signal]] to {folder / SCENARIO_FILE}, or every run is a success"
    about = f"{len(criteria)} of {total} reference values, at most one of an output; {more}"
    return sorted(folder.iterdir()), f"Criteria: {about}"


def _criteria(experiment: Experiment) -> Iterator[SignalCriterion]:
    """Yield one for each output of numbers, at the last instant that has references."""
    rows, ticks = experiment.compared()
    if not rows.size:
        return
    end = "end" if ticks[-1] == experiment.steps else float(ticks[-1] * experiment.step)
    for name, values in experiment.references.values.items():
        if values.dtype != object and np.isfinite(value := float(values[rows[-1]])):
            bound, signal = experiment.tolerance * max(abs(value), 1.0), f"{IT}.{name}"
            yield SignalCriterion(signal, "final", to=end, above=value - bound, below=value + bound)


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
            found[role].append(experiment_of(fmu, source, {}, references=references))
    return found["experiment"] or found["result"]


def _listed(fmu: Fmu, file: Path) -> Iterator[Experiment]:
    for element in _read(fmu, file).iter("Experiment"):
        files = {part.tag: _member(fmu, file, source)
                 for part in element if (source := part.get("source"))}  # fmt: skip
        tables = {tag: _series(fmu, files[tag]) for tag in TABLES if tag in files}
        settings = {**element.attrib}
        for transient in element.iter("TransientSimulation"):  # where the newest draft has them
            settings |= transient.attrib
        values = _parameters(fmu, files["Parameters"]) if "Parameters" in files else {}
        name, references = element.get("name", ""), tables.get("References", Series())
        experiment = experiment_of(fmu, name, settings, references)
        yield replace(experiment, parameters=values, stimuli=tables.get("Stimuli", Series()))


def experiment_of(
    fmu: Fmu, name: str, settings: Mapping[str, str], references: Series
) -> Experiment:
    """Return an experiment; what it does not set, the FMU's default experiment does."""
    default, times = fmu.description.defaultExperiment, references.times
    spacing = float(np.diff(times).min()) if len(times) > 1 else 0.001
    last = float(times[-1]) if len(times) else 1.0
    numbers = {"startTime": 0.0, "stopTime": last, "stepSize": spacing, "tolerance": TOLERANCE}
    for key, value in numbers.items():
        # The default experiment's tolerance is its solver's.
        preset = getattr(default, key, None) if key != "tolerance" else None
        text = settings.get(key, preset) or str(value)
        number = finite_number(text)
        bound = " above 0" if key in ("stepSize", "tolerance") else ""
        if number is None or (bound and number <= 0.0):
            place = f"{fmu.label}: experiment {name!r}: {key}"
            refuse(place, text, f"must be a finite number{bound}")
        numbers[key] = number
    start, stop, step, tolerance = numbers.values()
    return Experiment(name, start, stop, step, tolerance, references=references)


def _read(fmu: Fmu, file: Path) -> Element:
    return read_xml(file, f"{fmu.label}: {file.name}")


def _member(fmu: Fmu, file: Path, source: str) -> Path:
    return file_inside(file.parent, source, fmu.folder, fmu.label)


def _series(fmu: Fmu, file: Path) -> Series:
    """Read a CSV; a cell of an array has all its elements, bytes are hexadecimal digits."""
    place = f"{fmu.label}: {file.name}"
    values: dict[str, Array] = {}
    table = InputTable.read(file, place)
    for name, cells in table.columns.items():
        with located(file.name):  # values of another FMU, or of another version of it
            scalars = scalars_of(fmu, name)
        kind, count = scalars[0].variable.kind, len(scalars)
        rows = [cell.split() if count > 1 else [cell.strip()] for cell in cells]
        try:
            parts = np.array([[_cell(kind, word) for word in row] for row in rows],
                             object if kind in TEXTS else float)  # fmt: skip
            columns = parts.reshape(len(rows), count).T
        except ValueError as error:
            values_of = "a value" if count == 1 else f"{count} values"
            must = f"must have {values_of} of type {kind} in each row"
            raise InputError(f"{place}: {name}: {must}") from error
        values |= zip((scalar.name for scalar in scalars), columns, strict=True)
    return Series(np.array(table.times), values)


def scalars_of(fmu: Fmu, name: str) -> list[Scalar]:
    """Return the elements of an array, or the one variable of that name."""
    return by_array(fmu.variables.values()).get(name) or [fmu.variable(name)]


def _cell(kind: str, word: str) -> float | str:
    if kind in TEXTS:
        return word.lower() if kind == "Binary" else word
    return float(_SWITCHES.get(word, word))


def _parameters(fmu: Fmu, file: Path) -> dict[str, Value]:
    """Read a parameter set (SSV); one of an array has all its elements."""
    values: dict[str, Value] = {}
    for parameter in _read(fmu, file).iterfind(".//{*}Parameter"):
        name = parameter.get("name", "")
        scalars, place = scalars_of(fmu, name), f"{fmu.label}: {file.name}: {name}"
        text = parameter[0].get("value", "") if len(parameter) else ""
        texts = text.split() if len(scalars) > 1 else [text]
        if len(texts) != len(scalars):
            raise InputError(f"{place}: {len(texts)} values; must be {len(scalars)}")
        for scalar, each in zip(scalars, texts, strict=True):
            values[scalar.name] = read_value(f"{place} =", scalar.variable, each)
    return values
