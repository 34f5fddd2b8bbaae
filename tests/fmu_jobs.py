"""Jobs that tests run with FMUs in a separate process (see `fmu_support.in_process`)."""

from __future__ import annotations

import ctypes
import gc
import os
import random
import shutil
import sys
import types
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions
from fmpy.logging import addLoggerProxy
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.master.system import open_slave

TICK = 0.001


class Instance:
    """An instance that keeps what it logs, and the status of each call.

    Args:
        fmu: The FMU.
        name: Instance name.
        folder: Where it is unpacked; None: in the cache.
    """

    def __init__(self, fmu: Fmu, name: str = "it", folder: Path | None = None) -> None:
        self.fmi = FMU2Slave(
            guid=fmu.guid,
            unzipDirectory=str(folder or fmu.folder),
            modelIdentifier=fmu.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu = fmu
        self.log: list[tuple[int, str, str]] = []
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self._keep_log)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        addLoggerProxy(ctypes.byref(callbacks))
        self.fmi.instantiate(callbacks=callbacks, loggingOn=True)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.fmi, name)

    def _keep_log(self, _env: Any, _name: bytes, status: int, kind: bytes, text: bytes) -> None:
        self.log.append((status, (kind or b"-").decode(), text.decode()))

    def references(self, names: Sequence[str]) -> list[int]:
        """Value references of scalar variables."""
        return [self.fmu.variables[name].value_reference for name in names]

    def set(self, values: Mapping[str, Any]) -> None:
        """Set scalar variables."""
        for name, value in values.items():
            variable = self.fmu.variables[name]
            kind = "Integer" if variable.variable.kind == "Enumeration" else variable.variable.kind
            setter = getattr(self.fmi, f"set{kind}")
            setter([variable.value_reference], [variable.converted(value)])

    def get(self, *names: str) -> list[float]:
        """Values of scalar variables of type Real."""
        values: list[float] = self.getReal(self.references(names))
        return values

    def outputs(self) -> list[float]:
        """Values of all outputs."""
        names = [n for n, v in self.fmu.variables.items() if v.variable.causality == "output"]
        return self.get(*names)

    def start(self, values: Mapping[str, Any] | None = None) -> Instance:
        """Set values and go through initialization."""
        self.setupExperiment(startTime=0.0)
        self.set(values or {})
        self.enterInitializationMode()
        self.exitInitializationMode()
        return self

    def step(self, tick: int, size: float = TICK) -> int:
        """Step from a tick; returns the status."""
        status: int = self.dll.fmi2DoStep(
            ctypes.c_void_p(self.component),
            ctypes.c_double(tick * TICK),
            ctypes.c_double(size),
            ctypes.c_int(1),
        )
        return status

    def steps(self, first: int, count: int) -> None:
        """Step by ticks; each must succeed."""
        for tick in range(first, first + count):
            assert self.step(tick) == 0, self.log

    def messages(self) -> str:
        """All that has been logged."""
        return "\n".join(text for _, _, text in self.log)

    def excite(self, tick: int) -> None:
        """Set inputs that depend on the tick alone."""
        source = random.Random(tick)
        values = {n: v for n, v in self.fmu.variables.items() if v.variable.causality == "input"}
        inputs = {n: float(v.start) + 0.02 * source.random() for n, v in values.items()}
        for name in ("grip_cmd", "ctrl[8]"):
            if name in inputs:
                inputs[name] = float(values[name].start) * source.random()
        self.setReal(self.references(list(inputs)), list(inputs.values()))

    def zero(self) -> None:
        """Set all inputs to 0, as some importers do."""
        names = [n for n, v in self.fmu.variables.items() if v.variable.causality == "input"]
        self.setReal(self.references(names), [0.0] * len(names))

    def restore(self, data: str) -> None:
        """Restore a state from its bytes in hexadecimal digits."""
        state = self.deSerializeFMUstate(bytes.fromhex(data))
        self.setFMUstate(state)
        self.freeFMUstate(state)

    def set_bytes(self, reference: int, data: str) -> None:
        """Set a String from bytes in hexadecimal digits."""
        texts = (ctypes.c_char_p * 1)(bytes.fromhex(data))
        vrs = (ctypes.c_uint * 1)(reference)
        self.dll.fmi2SetString(ctypes.c_void_p(self.component), vrs, ctypes.c_size_t(1), texts)

    def play(self, first: int, count: int) -> list[list[float]]:
        """Excite and step; returns the outputs after each step."""
        rows = []
        for tick in range(first, first + count):
            self.excite(tick)
            self.steps(tick, 1)
            rows.append(self.outputs())
        return rows


def poisoned(path: str, folder: str) -> list[float]:
    """Run an FMU in a process whose modules of the FMU's names are empty, or raise.

    Args:
        path: The FMU.
        folder: Folder with modules that raise.
    """
    fmu = Fmu(Path(path))
    names = ("plant", "controller", "assets", "fmus", "pythonfmu")
    for module in [m for m in sys.modules if m.partition(".")[0] in names]:
        del sys.modules[module]
    for name in ("fmus", "pythonfmu"):
        sys.modules[name] = types.ModuleType(name)
    sys.path.insert(0, folder)
    return plain(path, fmu)


def plain(path: str, fmu: Fmu | None = None) -> list[float]:
    """Run an FMU for three steps."""
    it = Instance(fmu or Fmu(Path(path))).start()
    it.steps(0, 3)
    return it.outputs()


def side_by_side(first: str, second: str) -> list[list[float]]:
    """Run two builds of an FMU in one process, in turns."""
    instances = [Instance(Fmu(Path(p))).start() for p in (first, second, first, second)]
    for tick in range(3):
        for it in instances:
            it.steps(tick, 1)
    return [it.outputs() for it in instances]


def moved(path: str, scratch: str) -> list[list[float]]:
    """Run an FMU, delete its folder, unpack it elsewhere, and run it again."""
    fmu, results = Fmu(Path(path)), []
    for i in range(2):
        folder = Path(scratch) / f"place {i}"
        shutil.copytree(fmu.folder, folder)
        it = Instance(fmu, folder=folder).start()
        it.steps(0, 3)
        results.append(it.outputs())
        it.terminate()
        it.freeInstance()
        shutil.rmtree(folder)
    return results


def scripted(path: str, script: Sequence[Sequence[Any]]) -> dict[str, Any]:
    """Do what a script says with an instance that has not been initialized.

    Args:
        path: The FMU.
        script: Calls as (method of `Instance`, arguments...).

    Returns:
        The result of each call, or the status of one that was refused; and the log.
    """
    it = Instance(Fmu(Path(path)))
    results = [_result(getattr(it, name), arguments) for name, *arguments in script]
    safe = [r if isinstance(r, int) or _are_numbers(r) else None for r in results]
    return {"results": safe, "log": it.log, "files": _names(Path.cwd())}


def _result(call: Any, arguments: Sequence[Any]) -> Any:
    try:
        return call(*arguments)
    except FMICallException as error:
        return error.status


def reset(path: str, values: dict[str, Any]) -> list[list[float]]:
    """Compare an instance that was used and reset with a new one, both with these values."""
    fmu = Fmu(Path(path))
    used = Instance(fmu).start(values)
    used.play(0, 20)
    used.reset()
    fresh = Instance(fmu)
    return [it.start().play(0, 20)[-1] for it in (used, fresh)]


def substeps(path: str) -> list[list[float]]:
    """Compare one step of 5 ms with five of 1 ms."""
    fmu = Fmu(Path(path))
    coarse, fine = Instance(fmu).start(), Instance(fmu).start()
    for it in (coarse, fine):
        it.excite(7)
    assert coarse.step(0, 0.005) == 0
    fine.steps(0, 5)
    return [coarse.outputs(), fine.outputs()]


def replay(path: str, values: dict[str, Any], folder: str) -> int:
    """Restore and replay from 50 random instants, in place and in an instance with other values.

    Leaves serialized states and what follows them in the folder.

    Returns:
        Number of instants at which the replay was equal.
    """
    fmu = Fmu(Path(path))
    instants = sorted(random.Random(1).sample(range(1, 380), 50))
    it, other = Instance(fmu).start(values), Instance(fmu).start()
    rows, states = [], {}
    for tick in range(400):
        if tick in instants:
            states[tick] = it.getFMUstate()
        rows += it.play(tick, 1)
    equal = 0
    for k, tick in enumerate(instants):
        data = it.serializeFMUstate(states[tick])
        (Path(folder) / f"{tick}.state").write_bytes(data)
        which = other if k % 2 else it
        copied = which.deSerializeFMUstate(data)
        which.setFMUstate(copied)
        assert which.serializeFMUstate(copied) == data
        equal += which.play(tick, 20) == rows[tick : tick + 20]
        which.freeFMUstate(copied)
        it.freeFMUstate(states[tick])
    (Path(folder) / "rows").write_text("\n".join(" ".join(x.hex() for x in r) for r in rows))
    return equal


def replay_elsewhere(path: str, folder: str) -> int:
    """Replay from the states that `replay` left, in a new process; returns as it does."""
    fmu = Fmu(Path(path))
    lines = (Path(folder) / "rows").read_text().splitlines()
    rows = [[float.fromhex(x) for x in line.split()] for line in lines]
    it, equal = Instance(fmu), 0
    for file in Path(folder).glob("*.state"):
        state = it.deSerializeFMUstate(file.read_bytes())
        it.setFMUstate(state)
        it.freeFMUstate(state)
        tick = int(file.stem)
        equal += it.play(tick, 20) == rows[tick : tick + 20]
    return equal


def interleave(path: str) -> bool:
    """Step ten instances in random order; tell whether each gives what it gives alone."""
    fmu = Fmu(Path(path))
    source = random.Random(3)
    crowd = [Instance(fmu, f"it{i}").start() for i in range(10)]
    last: list[list[float]] = [[]] * 10
    ticks = [0] * 10
    while min(ticks) < 40:
        i = source.randrange(10)
        last[i] = crowd[i].play(ticks[i], 1)[-1]
        ticks[i] += 1
    source.shuffle(crowd_order := list(range(10)))
    for i in crowd_order:
        crowd[i].freeInstance()
    return all(
        Instance(fmu, f"alone{i}").start().play(0, ticks[i])[-1] == last[i] for i in range(10)
    )


def cycles(path: str, count: int) -> dict[str, Any]:
    """Instantiate, step and free; returns how memory and open files grew after the first 60."""
    fmu = Fmu(Path(path))
    before: tuple[int, int, int] | None = None
    folders = set(_names(Path(os.environ["TMPDIR"])))
    for i in range(count):
        if i == 60:
            gc.collect()
            before = _resident(), len(_names(Path("/proc/self/fd"))), len(sys.path)
        it = Instance(fmu).start()
        it.steps(0, 1)
        if i % 3:
            it.terminate()
        it.freeInstance()
    gc.collect()
    assert before
    return {
        "kilobytes": _resident() - before[0],
        "files": len(_names(Path("/proc/self/fd"))) - before[1],
        "paths": len(sys.path) - before[2],
        "folders": sorted(set(_names(Path(os.environ["TMPDIR"]))) - folders),
    }


def _are_numbers(result: Any) -> bool:
    return isinstance(result, list) and all(isinstance(x, float) for x in result)


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _resident() -> int:
    """Resident memory of this process [kB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def coupled(plant_path: str, controller_path: str, commands: list[list[float]]) -> list[str]:
    """Couple plant and controller, Gauss-Seidel, through FMPy's own methods.

    Args:
        plant_path: The plant's FMU.
        controller_path: The controller's FMU.
        commands: Commands of each tick.

    Returns:
        The plant's outputs after each tick, as hexadecimal floats in one text.
    """
    plant = Instance(Fmu(Path(plant_path))).start()
    controller = Instance(Fmu(Path(controller_path))).start()
    measured, ctrl = wires()
    rows = []
    for tick, command in enumerate(commands):
        controller.setReal(list(range(len(command))), command)
        controller.setReal(controller.references(measured), plant.get(*measured))
        controller.steps(tick, 1)
        plant.setReal(plant.references(ctrl), controller.get(*ctrl))
        plant.steps(tick, 1)
        rows.append(" ".join(x.hex() for x in plant.outputs()))
    return rows


def played(
    path: str, count: int, step_ticks: int, table: str = "", start: int = 0
) -> list[list[float]]:
    """Outputs of the trajectory FMU at the start and after each step.

    Args:
        path: The FMU.
        count: Number of steps.
        step_ticks: Length of each [tick].
        table: CSV file to play instead.
        start: Start time [tick].
    """
    it = Instance(Fmu(Path(path)))
    it.setupExperiment(startTime=start * TICK)
    it.set({"table": table})
    it.enterInitializationMode()
    it.exitInitializationMode()
    rows = [it.outputs()]
    for i in range(count):
        assert it.step(start + i * step_ticks, step_ticks * TICK) == 0, it.messages()
        rows.append(it.outputs())
    return rows


def wires() -> tuple[list[str], list[str]]:
    """Names of what goes from plant to controller, and back; the same at both ends."""
    from panda_cosim.fmus.interface.tables import CONNECTIONS  # noqa: PLC0415 - hidden from `poisoned`

    measured = [c.source[1] for c in CONNECTIONS if c.source[0] == "plant"]
    return measured, [c.source[1] for c in CONNECTIONS if c.source[0] == "controller"]


def ours(path: str) -> list[float]:
    """Outputs of the plant after 20 steps of the master's own instance."""
    fmu = Fmu(Path(path))
    slave = open_slave("it", fmu)
    slave.initialize({"block_mass": 0.3}, 0.0, 1.0)
    for tick in range(20):
        slave.step(tick * TICK, TICK)
    outputs: list[float] = slave.get_real(
        [n for n, v in fmu.variables.items() if v.variable.causality == "output"]
    ).tolist()
    slave.close()
    return outputs


def simulate(path: str, stop: float) -> list[str]:
    """Run `fmpy.simulate_fmu`; returns the names of the result's columns."""
    result = fmpy.simulate_fmu(path, stop_time=stop, step_size=TICK, output_interval=TICK)
    assert len(result) == round(stop / TICK) + 1
    return list(result.dtype.names)


def refused(path: str, values: dict[str, Any]) -> list[Any]:
    """Start with values and step; return whether that was refused, and the log."""
    it = Instance(Fmu(Path(path)))
    try:
        it.start(values)
        ended = it.step(0) > 1
    except FMICallException:
        ended = True
    return [ended, it.messages()]


def block_starts(path: str, scene: str, x: float, y: float, yaw: float) -> list[Any]:
    """The block's pose at the start, or why it is refused: of the native plant, and of Python's."""
    from panda_cosim.fmus.errors import CosimError  # noqa: PLC0415
    from panda_cosim.fmus.master.system import open_slave  # noqa: PLC0415
    from panda_cosim.plant.plant import Plant, PlantParameters  # noqa: PLC0415

    slave = open_slave("plant", _opened(path))
    start = {"scene": scene, "block_pos[1]": x, "block_pos[2]": y, "block_yaw": yaw}
    outcomes: list[Any] = []
    try:
        slave.initialize(start, 0.0, 1.0)
        outcomes.append(slave.get_real([f"qpos[{i}]" for i in range(10, 17)]).tolist())
    except CosimError as error:
        outcomes.append(_refusal(str(error)))
    slave.close()
    try:
        plant = Plant(PlantParameters(scene=scene, block_pos=(x, y), block_yaw=yaw))
        outcomes.append(plant.outputs["qpos"][9:16].tolist())
    except ValueError as error:
        outcomes.append(_refusal(str(error)))
    return outcomes


@cache
def _opened(path: str) -> Fmu:
    return Fmu(Path(path))


def _refusal(text: str) -> str:
    """From the first words that both plants have in common."""
    return text[text.index("would start") :]
