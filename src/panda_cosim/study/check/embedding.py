"""Puts reference experiments into the FMUs that we build, driven as in a scenario.

See `experiments` for the format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...fmus.atomic import replacing
from ...fmus.build.description import literal, render
from ...fmus.build.native import add_members
from ...fmus.build.ssp import Component, parameter_set
from ...fmus.errors import CosimError
from ...fmus.interface.tables import Connection
from ...fmus.master.fmu_file import TEXTS, Fmu, read_fmu
from ...fmus.master.system import in_units, multiples_of, read_fmus
from ...fmus.master.wiring import Name
from ...run.options import Options
from ...run.prepare import LISTENING, prepare
from ...task.files import csv_text
from ...task.scenario import Scenario
from .diagnosis import rehearse
from .experiments import (
    FOLDER,
    IT,
    MANIFEST,
    MOST_COMPARED,
    Experiment,
    Series,
    answer,
    experiment_of,
    first_of,
    scalars_of,
)

Array = NDArray[np.float64]

# More values of a stimulus are thinned; rows of references.
MOST_CELLS, MOST_REFERENCES = 60_000, 200


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
            ahead = _ahead(each, scenario.coupling, fmus, multiples)
            values = np.append(values[ahead:], np.repeat(values[-1:], ahead))
            fed[each.target] = linear.factor * values + linear.offset
    experiments = {}
    for instance, interface in assembly.interfaces.items():
        driven = {name: values for (owner, name), values in fed.items() if owner == instance}
        every = math.ceil(recording.rows * len(driven) / MOST_CELLS) or 1
        rows = np.unique([*range(0, recording.rows, every), recording.rows - 1])
        stimuli = Series(recording.time[rows], {n: each[rows] for n, each in driven.items()})
        starts = {s.name: s.start for s in interface.scalars()}
        given = prepared.start_values().get(instance, {})
        experiments[instance] = Experiment(
            scenario.name, recording.time[0], recording.time[-1],
            scenario.step * multiples.get(instance, 1),
            description=f"{interface.model} as driven in the scenario {scenario.name}",
            parameters={n: v for n, v in given.items() if v != starts[n] and n not in driven},
            stimuli=stimuli if driven else Series(),
        )  # fmt: skip
    return experiments


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


def add_experiment(path: Path, experiment: Experiment | None = None) -> Experiment:
    """Put an experiment into a new FMU's file, with what the FMU answers now as references."""
    # Without one, it is the FMU's default experiment. An FMU that holds some keeps these.
    fmu = read_fmu(path)
    if (fmu.folder / FOLDER / MANIFEST).is_file():
        return first_of(fmu)
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
    return whole


def series_text(fmu: Fmu, series: Series) -> bytes:
    """Format values as CSV, by the FMU's own names; an array of FMI 3.0 is one column."""
    # Its elements that have no values keep their start value.
    columns: list[Iterable[str]] = [map(repr, series.times.tolist())]
    names = dict.fromkeys(fmu.variables[name].variable.name for name in series.values)
    for scalars in (scalars_of(fmu, name) for name in names):
        values = ((s, series.values.get(s.name, np.full(len(series.times), s.start)))
                  for s in scalars)  # fmt: skip
        texts = [[literal(scalar, value) for value in each.tolist()] for scalar, each in values]
        columns.append(map(" ".join, zip(*texts, strict=True)))
    head = ",".join(f'"{name}"' for name in ("time", *names))
    return f"{head}\n{csv_text(zip(*columns, strict=True))}".encode()


def write_compatibility(path: Path, experiment: Experiment) -> None:
    """Write a folder with an FMU and the files that the FMI cross-check rules ask for."""
    fmu, name = read_fmu(path), path.stem
    references = experiment.references
    owner = {name: fmu.variables[name].variable.name for name in references.values}
    first = [*dict.fromkeys(owner.values())][:MOST_COMPARED]  # whole arrays
    compared = {name: each for name, each in references.values.items() if owner[name] in first}
    texts = {"it": experiment, "model": name, "about": fmu.description}
    files = {
        f"{name}.fmu": path.read_bytes(),
        f"{name}_ref.csv": series_text(fmu, Series(references.times, compared)),
        f"{name}_ref.opt": render("experiment.opt.j2", it=experiment),
        "ReadMe.txt": render("experiment.txt.j2", **texts),
    }
    if experiment.stimuli.values:
        files[f"{name}_in.csv"] = series_text(fmu, experiment.stimuli)
    for member, content in files.items():
        with replacing(path.with_suffix("") / member) as partial:
            partial.write_bytes(content)
