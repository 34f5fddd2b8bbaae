"""Puts reference experiments into the FMUs that we build, driven as in a scenario.

See `experiments` for the format.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...assets.fields import Array
from ...fmus.build.description import literal, render
from ...fmus.build.native import add_members
from ...fmus.build.ssp import Component, parameter_set
from ...fmus.errors import CosimError
from ...fmus.interface.tables import Connection
from ...fmus.interface.variables import by_array
from ...fmus.master.fmu_file import TEXTS, Fmu, read_fmu
from ...fmus.master.system import in_units, multiples_of, read_fmus
from ...run.options import Options
from ...run.prepare import LISTENING, prepare
from ...task.input_table import InputTable
from ...task.scenario import Scenario
from .diagnosis import rehearse
from .experiments import (
    FOLDER,
    IT,
    MANIFEST,
    Experiment,
    Series,
    answer,
    experiment_of,
)

# More values of a stimulus are thinned; rows of references.
MOST_CELLS, MOST_REFERENCES = 60_000, 200


def experiments_of(scenario: Scenario) -> dict[str, Experiment]:
    """Run a scenario in memory; by instance, what drives each FMU as it was driven there."""
    prepared = prepare(scenario, Options())
    recording, assembly = rehearse(prepared).recording, prepared.assembly
    fmus = read_fmus(assembly.system, prepared.start_values(), scenario.coupling)
    multiples = multiples_of(fmus, assembly.system, scenario.step)
    fed: dict[str, dict[str, Array]] = {instance: {} for instance in assembly.interfaces}
    for each in (*(Connection(name, name) for name in assembly.external), *assembly.connections):
        if assembly.scalars[each.target].variable.kind not in TEXTS:
            values, linear = recording[".".join(each.source)], in_units(fmus, each)
            ahead = _ahead(each, scenario.coupling, fmus, multiples)
            values = np.append(values[ahead:], np.repeat(values[-1:], ahead))
            fed[each.target[0]][each.target[1]] = linear.factor * values + linear.offset
    given = prepared.start_values()
    return {
        instance: Experiment(
            scenario.name, recording.time[0], recording.time[-1],
            scenario.step * multiples.get(instance, 1),
            description=f"{interface.model} as driven in the scenario {scenario.name}",
            parameters={
                name: value for name, value in given.get(instance, {}).items()
                if name not in fed[instance] and value != assembly.scalars[instance, name].start
            },
            stimuli=_thinned(recording.time, fed[instance]),
        )
        for instance, interface in assembly.interfaces.items()
    }  # fmt: skip


def _thinned(times: Array, driven: Mapping[str, Array]) -> Series:
    """Return inputs over time, with their last row, as far as the file stays small."""
    every = math.ceil(len(times) * len(driven) / MOST_CELLS) or 1
    rows = np.union1d(np.arange(0, len(times), every), len(times) - 1)
    return Series(times[rows], {name: values[rows] for name, values in driven.items()})


def _ahead(
    connection: Connection, coupling: str, fmus: Mapping[str, Fmu], multiples: Mapping[str, int]
) -> int:
    """Rows after the one of a step's begin that holds what the step was fed."""
    (feeder, _), (fed, _) = connection.source, connection.target
    if connection.source == connection.target or coupling == "jacobi":
        return 0
    order = [*fmus]
    leads = order.index(feeder) < order.index(fed) and fmus[feeder].answers_at_end
    return multiples.get(feeder, 1) if leads else int(coupling == "iterated")


def add_experiment(path: Path, experiment: Experiment | None = None) -> None:
    """Put an experiment into a new FMU's file, with what the FMU answers now as references."""
    # Without one, it is the FMU's default experiment. An FMU that holds some keeps these.
    fmu = read_fmu(path)
    if (fmu.folder / FOLDER / MANIFEST).is_file():
        return
    if {*LISTENING} <= fmu.variables.keys():
        raise CosimError("it waits for a program")
    driven = experiment or experiment_of(fmu, "default", {}, Series())
    recording = answer(fmu, driven)
    every = math.ceil(recording.rows / MOST_REFERENCES)
    answers = {
        scalar.name: recording[f"{IT}.{scalar.name}"][::every]
        for scalar in fmu.variables.values()
        if scalar.variable.causality == "output" and scalar.variable.kind not in TEXTS
    }
    whole = replace(driven, references=Series(recording.time[::every], answers))
    files = {
        MANIFEST: render("experiment.manifest.j2", it=whole),
        "reference.exp": render("experiment.exp.j2", it=whole),
        "references.csv": series_text(fmu, whole.references),
    }
    if whole.parameters:
        component = Component(path, path.name, fmu.fmi, fmu.variables, fmu.units, whole.parameters)
        files["parameters.ssv"] = parameter_set(whole.name, component)
    if whole.stimuli.values:
        files["stimuli.csv"] = series_text(fmu, whole.stimuli)
    with path.open("r+b") as file:
        add_members(file, {f"{FOLDER}/{name}": content for name, content in files.items()})


def series_text(fmu: Fmu, series: Series) -> bytes:
    """Format values as CSV, by the FMU's own names; an array of FMI 3.0 is one column."""
    # Its elements that have no values keep their start value.
    arrays, columns = by_array(fmu.variables.values()), {}
    for name in dict.fromkeys(fmu.variables[name].variable.name for name in series.values):
        values = ((s, series.values.get(s.name, np.full(len(series.times), s.start)))
                  for s in arrays[name])  # fmt: skip
        texts = [[literal(scalar, value) for value in each.tolist()] for scalar, each in values]
        columns[name] = tuple(map(" ".join, zip(*texts, strict=True)))
    return InputTable(tuple(series.times.tolist()), columns).text.encode()
