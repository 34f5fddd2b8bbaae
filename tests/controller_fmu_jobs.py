"""What tests do with the native controller FMU, each in a process of its own."""

from __future__ import annotations

from pathlib import Path

from native_support import ERROR, OK, STEP, Instance, Row, Table, unpacked
from panda_cosim.controller.model import arm_mjb
from panda_cosim.fmus.build.libraries import compile_library
from panda_cosim.fmus.interface.controller import CONTROLLER
from panda_cosim.fmus.interface.variables import Variable

Numbers = list[float]  # or truth values, of a Boolean
Rows = list[Numbers]


def _expanded(numbers: object, count: int) -> tuple[float, ...]:
    """One number for each element, or none."""
    if numbers is None:
        return ()
    if isinstance(numbers, tuple):
        return tuple(map(float, numbers))
    return (float(numbers),) * count  # type: ignore[arg-type]


def _row(variable: Variable) -> Row:
    count = len(list(variable.names()))
    return Row(
        variable.name,
        variable.causality,
        variable.shape,
        variability=variable.variability,
        kind=variable.kind,
        start=_expanded(variable.start, count),
        minimum=_expanded(variable.minimum, count),
        maximum=_expanded(variable.maximum, count),
    )


TABLE = Table(tuple(_row(variable) for variable in CONTROLLER.variables))
INPUTS = sum(len(list(v.names())) for v in CONTROLLER.of("input"))
OUTPUTS = sum(len(list(v.names())) for v in CONTROLLER.of("output"))


def unpack(folder: str, *flags: str) -> None:
    """Write the FMU, compiled with further flags."""
    library = compile_library("controller", extra_flags=flags) if flags else None
    unpacked(Path(folder), "controller", TABLE, {"arm.mjb": arm_mjb()}, library=library)


def _outputs(it: Instance) -> Numbers:
    return [value for row in TABLE.rows if row.causality == "output" for value in it.get(row.name)]


def _step(it: Instance, tick: int, inputs: Numbers) -> Numbers:
    at = 0
    for row in TABLE.rows:
        if row.causality == "input":
            count = len(TABLE.elements(row.name))
            assert it.set(row.name, *inputs[at : at + count]) == OK
            at += count
    assert it.step(tick * STEP) == OK, it.messages()
    return _outputs(it)


def _instance(folder: str, version: int, parameters: dict[str, Numbers]) -> Instance:
    it = Instance(Path(folder), TABLE, version)
    for name, values in parameters.items():
        assert it.set(name, *values) == OK, it.messages()
    return it.start()


def replay(folder: str, version: int, parameters: dict[str, Numbers], inputs: Rows) -> Rows:
    """Outputs after each step."""
    it = _instance(folder, version, parameters)
    return [_step(it, tick, row) for tick, row in enumerate(inputs)]


def rolled_back(folder: str, version: int, inputs: Rows) -> list[Rows]:
    """Outputs of the second half of the inputs: straight on, rolled back, in another instance."""
    half = len(inputs) // 2
    it = _instance(folder, version, {"ki": [2.0] * 7, "kd": [0.05] * 7})

    def go_on(instance: Instance) -> Rows:
        return [_step(instance, half + i, row) for i, row in enumerate(inputs[half:])]

    for tick, row in enumerate(inputs[:half]):
        _step(it, tick, row)
    state = it.save()
    results = [go_on(it)]
    assert it.load(state) == OK, it.messages()
    results.append(go_on(it))
    other = _instance(folder, version, {})
    status, foreign = other.deserialize(it.serialize(state))
    assert status == OK, other.messages()
    assert other.load(foreign) == OK, other.messages()
    return [*results, go_on(other)]


def tuned(folder: str, version: int, inputs: Rows) -> list[Rows]:
    """Outputs where kp is 3 from the middle on, and where the law changes there, too."""
    results = []
    for change in ({"kp": [3.0] * 7}, {"use_reference": [False]}):
        it, half = _instance(folder, version, {}), len(inputs) // 2
        rows = [_step(it, tick, row) for tick, row in enumerate(inputs[:half])]
        for name, values in change.items():
            assert it.set(name, *values) == OK, it.messages()
        results.append(rows + [_step(it, half + i, row) for i, row in enumerate(inputs[half:])])
    return results


def refused(folder: str, version: int, name: str, values: Numbers) -> str:
    """What is logged where a start value cannot be."""
    it = Instance(Path(folder), TABLE, version)
    if it.set(name, *values) == OK:
        assert it.enter() == OK
        assert it("ExitInitializationMode") == ERROR
    return it.messages()


def logged(folder: str, version: int, inputs: Rows) -> tuple[list[str], Rows]:
    """Warnings, and outputs after each step."""
    it = _instance(folder, version, {})
    outputs = [_step(it, tick, row) for tick, row in enumerate(inputs)]
    return [text for _, _, text in it.log], outputs
