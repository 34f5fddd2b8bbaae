"""FMUs with faults, for the tests: made with PythonFMU, in the shape of this project's own.

What goes wrong is told by the environment variable FAULT, as `segfault@20`: at the 20th step. So
one FMU serves for all faults.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import forked
import pytest
from couple_support import panda_system
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.master.system import open_slave, open_system
from panda_cosim.plant.plant import Plant
from panda_cosim.scenarios.scenario.scenario import SCENARIO_FILE, TABLE_FILE

SCRIPT = '''
import ctypes, json, os, subprocess, sys, threading, time
from pythonfmu.fmi2slave import Fmi2Slave
from pythonfmu.enums import Fmi2Causality, Fmi2Variability
from pythonfmu.variables import Boolean, Real, String

SPEC = json.loads(r"""{spec}""")
KINDS = {{"Real": Real, "Boolean": Boolean, "String": String}}


class {model}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = {{}}
        self.steps = 0
        self.fault, _, at = os.environ.get("FAULT", "none").partition("@")
        self.at = int(at or -1)
        for name, kind, causality, variability, start in SPEC:
            self.values[name] = start
            more = {{}} if causality == "output" else {{"start": start}}
            self.register_variable(KINDS[kind](
                name,
                causality=Fmi2Causality[causality],
                variability=Fmi2Variability[variability],
                getter=lambda name=name: self.values[name],
                setter=lambda value, name=name: self.values.__setitem__(name, value),
                **more,
            ))
        self.fail("new")

    def exit_initialization_mode(self):
        self.fail("init")

    def do_step(self, time, step):
        self.steps += 1
        return self.fail("") is not False

    def fail(self, when):
        if when:
            due = self.fault.startswith(when + "-")
            fault = self.fault.removeprefix(when + "-")
        else:
            due, fault = self.steps == self.at, self.fault
        if fault.startswith("slow"):
            time.sleep(0.05)
        if not due:
            return None
        if "FAULT_FILE" in os.environ:
            open(os.environ["FAULT_FILE"], "w").close()
        if fault == "raise":
            raise ValueError("told to: 100%s of it\\nin two lines")
        if fault == "discard":
            return False
        if fault == "nan":
            self.values[{victim!r}] = float("nan")
        if fault == "infinite":
            self.values[{victim!r}] = float("inf")
        if fault == "short":
            self.get_real = lambda vrs: [0.0]
        if fault == "hang":
            while True:
                time.sleep(0.01)
        if fault == "spin":
            while True:
                pass
        if fault == "segfault":
            ctypes.string_at(0)
        if fault == "abort":
            os.abort()
        if fault == "exit":
            os._exit(3)
        if fault == "c-exit":
            ctypes.CDLL(None).exit(0)
        if fault == "locked-exit":
            ctypes.PyDLL(None).exit(0)
        if fault == "python-exit":
            ctypes.pythonapi.Py_Exit(0)
        if fault.startswith("thread-exit"):
            threading.Thread(target=ctypes.CDLL(None).exit, args=[0]).start()
            time.sleep(30 if fault == "thread-exit-hang" else 0)
        if fault == "fork-exit":
            if os.fork() == 0:
                ctypes.CDLL(None).exit(0)
            os.wait()
        if fault == "read" and os.read(0, 1):
            raise ValueError("there was something to read")
        if fault == "orphan":
            subprocess.Popen(["sleep", "300.25"], stdout=-3, stderr=-3)
            os._exit(3)
        if fault == "close-fds":
            os.closerange(3, 256)
            while True:
                time.sleep(0.01)


'''
_CHILD = (
    "import sys; from pythonfmu.builder import FmuBuilder; "
    "FmuBuilder.build_FMU(sys.argv[1], dest=sys.argv[2])"
)
VICTIMS = {"plant": "hand_xpos[2]", "controller": "ctrl[3]"}


def build_faulty(folder: Path, instance: str = "plant") -> Path:
    """Build an FMU that has the variables of an instance, and keeps their values."""
    model = f"Faulty{instance.capitalize()}"
    script = folder / f"{model.lower()}_script.py"
    spec = json.dumps(_spec(instance))
    script.write_text(SCRIPT.format(model=model, spec=spec, victim=VICTIMS[instance]))
    path = folder / f"{model}.fmu"
    command = [sys.executable, "-P", "-c", _CHILD, str(script), str(path)]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return path


def _spec(instance: str) -> list[tuple[object, ...]]:
    outputs = Plant().outputs
    spec: list[tuple[object, ...]] = []
    for variable in INTERFACES[instance].variables:
        still = outputs[variable.name].ravel() if variable.name in outputs.dtype.names else None
        for index, scalar in enumerate(
            s for s in INTERFACES[instance].scalars() if s.variable == variable
        ):
            start = scalar.start
            if variable.causality == "output":
                start = 0.0 if still is None else float(still[index])
            # PythonFMU has no enumerations; `scene` by its name in a String is taken, too.
            kind = "String" if variable.kind == "Enumeration" else variable.kind
            spec.append((scalar.name, kind, variable.causality, variable.variability, start))
    return spec


STARTING_LAW = """
import subprocess, sys

class Starts:
    "Holds the arm, and starts a Python."

    def start(self):
        subprocess.run([sys.executable, "-c", "import json, numpy"], check=True)

    def update(self, time, qpos):
        return [*qpos[:7], 255.0]
"""
TOML = """
purpose = "short"
scene = "tabletop"
duration = {duration}
"""
TABLE = """time,frame,x,y,z,grip
0.0,home,0.0,0.0,0.0,0.08
{duration},home,0.02,0.0,-0.02,0.08
"""


def write_scenario(folder: Path, duration: float = 0.2, more: str = "") -> Path:
    """Write a scenario in which the hand moves a little."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENARIO_FILE).write_text(TOML.format(duration=duration) + more)
    (folder / TABLE_FILE).write_text(TABLE.format(duration=duration))
    return folder


RUN = """
import json, sys, time
from pathlib import Path
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.run.run import run_scenario
from panda_cosim.fmus.errors import CosimError

def tell(done, _):
    print(done, time.monotonic(), flush=True)


scenario, out, given = sys.argv[1:4]
given = json.loads(given)
if "fmus" in given:
    from panda_cosim.fmus.sources.targets import build
    given["fmus"] = build(("controller", "plant")) | {k: Path(v) for k, v in given["fmus"].items()}
try:
    done = run_scenario(
        scenario, out, Options(**given), progress=tell
    )
except CosimError as error:
    print(f"{type(error).__name__}: {error}", file=sys.stderr)
    sys.exit(error.exit_code)
sys.exit(128 + done.signal if done.signal else 0)
"""


def run_command(scenario: Path | str, out: Path, **options: object) -> list[str]:
    """Command that runs a scenario and ends with the exit code of `panda-cosim run`."""
    return [sys.executable, "-P", "-c", RUN, str(scenario), str(out), json.dumps(options)]


def run_with_fault(
    fmu: Path, scenario: Path, out: Path, fault: str, **options: object
) -> subprocess.CompletedProcess[str]:
    """Run a scenario with a faulty FMU, in a process of its own."""
    fmus = {"controller" if "Controller" in fmu.name else "plant": str(fmu)}
    given = json.dumps({"fmus": fmus, **options})
    return forked.script(RUN, str(scenario), str(out), given, FAULT=fault)


def on_a_small_disk(
    disk: Path, size: str, script: str, command: Sequence[str | Path], **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a command on a disk that nobody else sees; skip the test where that cannot be had.

    Args:
        disk: Folder to mount it at.
        size: Of the disk, as `mount` takes it: "100k".
        script: For the shell: `"$@"` is the command, `$DISK` the folder.
        command: The command.
        **environment: Variables to set.
    """
    disk.mkdir()
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("needs unshare to mount a small disk that nobody else sees")
    mount = f'mount -t tmpfs -o size={size} none "$DISK" || exit 77; '
    ended = subprocess.run(
        [unshare, "-m", "sh", "-c", mount + script, "sh", *command],
        env=os.environ | {"DISK": str(disk)} | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if ended.returncode == 77 or "unshare failed" in ended.stderr:
        pytest.skip(f"cannot mount here: {ended.stderr.strip()}")
    return ended


def processes_with(*words: str) -> Sequence[int]:
    """Return the numbers of living processes whose command line or environment has all words."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                text = (entry / "cmdline").read_bytes() + (entry / "environ").read_bytes()
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
            except OSError:
                continue
            if state != "Z" and all(word.encode() in text for word in words):
                found.append(int(entry.name))
    return found


def start_wrong() -> str:
    """Give an FMU a start value that only it refuses; return what is said."""
    try:
        with open_system(panda_system(), {"controller": {"period": 0.0015}, "plant": {}}, stop=1.0):
            return ""
    except InputError as error:
        return str(error)


def complain_after_another_has_closed(first: str, second: str) -> str:
    """Let an FMU log after one that came later has gone; return what it is quoted with."""
    talker = open_slave("first", Fmu(Path(first)))
    open_slave("second", Fmu(Path(second))).close()
    gc.collect()
    try:
        talker.initialize({"period": 0.0015}, 0.0, 1.0)
    except InputError as error:
        return str(error)
    return ""
