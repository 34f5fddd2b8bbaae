"""FMUs with faults, for the tests: made with PythonFMU, in the shape of this project's own.

The environment variable FAULT tells what goes wrong, as `segfault@20`, at the 20th step, or
`segfault@init`. So one FMU serves for all faults.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import forked
from bounded import is_alive, ran
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.plant.plant import Plant
from panda_cosim.task.scenario import SCENARIO_FILE, TABLE_FILE

SCRIPT = '''
import ctypes, json, os, subprocess
from pythonfmu.fmi2slave import Fmi2Slave
from pythonfmu.enums import Fmi2Causality, Fmi2Variability
from pythonfmu.variables import Boolean, Real, String

SPEC = json.loads(r"""{spec}""")
KINDS = {{"Real": Real, "Boolean": Boolean, "String": String}}


class FaultyPlant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = {{}}
        self.steps = 0
        self.fault, _, self.at = os.environ.get("FAULT", "").partition("@")
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

    def exit_initialization_mode(self):
        self.fail("init")

    def do_step(self, time, step):
        self.steps += 1
        self.fail(str(self.steps))
        return True

    def fail(self, at):
        if at != self.at:
            return
        if "FAULT_FILE" in os.environ:
            open(os.environ["FAULT_FILE"], "w").close()
        if self.fault == "raise":
            raise ValueError("told to: 100%s of it\\nin two lines")
        if self.fault == "nan":
            self.values["hand_xpos[2]"] = float("nan")
        if self.fault == "hang":
            while True:
                pass
        if self.fault == "segfault":
            ctypes.string_at(0)
        if self.fault == "exit":
            os._exit(3)
        if self.fault == "c-exit":
            ctypes.CDLL(None).exit(0)
        if self.fault == "read" and os.read(0, 1):
            raise ValueError("there was something to read")
        if self.fault == "orphan":
            subprocess.Popen(["sleep", "300.25"], stdout=-3, stderr=-3)
            os._exit(3)


'''


def build_faulty(folder: Path) -> Path:
    """Build an FMU that has the plant's variables, and keeps their values."""
    outputs, spec = Plant().outputs, []
    for scalar in INTERFACES["plant"].scalars():
        variable, start = scalar.variable, scalar.start
        if variable.causality == "output":
            known = variable.name in outputs.dtype.names
            start = float(outputs[variable.name].ravel()[scalar.element]) if known else 0.0
        elif variable.causality == "local":
            start = 0.0
        # PythonFMU has no enumerations; `scene` by its name in a String is taken, too.
        kind = "String" if variable.kind == "Enumeration" else variable.kind
        spec.append((scalar.name, kind, variable.causality, variable.variability, start))
    script, path = folder / "faultyplant_script.py", folder / "FaultyPlant.fmu"
    script.write_text(SCRIPT.format(spec=json.dumps(spec)))
    code = "from pythonfmu.builder import FmuBuilder as B; B.build_FMU({!r}, dest={!r})"
    ran([sys.executable, "-P", "-c", code.format(str(script), str(path))])
    return path


STARTING_LAW = """
import subprocess, sys

class Starts:
    "Holds the arm, and starts a Python."

    def start(self):
        subprocess.run([sys.executable, "-c", "import json, numpy"], check=True)

    def update(self, time, qpos):
        return [*qpos[:7], 255.0]
"""


def write_scenario(folder: Path, duration: float = 0.2, more: str = "") -> Path:
    """Write a scenario in which the hand moves a little."""
    rows = ("0,home,0,0,0,0.08", f"{duration},home,0.02,0,-0.02,0.08")
    return write_files(folder, f"duration = {duration}\n{more}", *rows)


def write_files(folder: Path, settings: str, *rows: str) -> Path:
    """Write a scenario's files, with these rows in the table or two that keep the hand at home."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENARIO_FILE).write_text(settings)
    table = ["time,frame,x,y,z,grip", *(rows or ("0,home,0,0,0,0.08", "1,home,0,0,0,0.08")), ""]
    (folder / TABLE_FILE).write_text("\n".join(table))
    return folder


RUN = """
import json, sys, time
from pathlib import Path
from panda_cosim.run.options import Options
from panda_cosim.run.execution import run_scenario
from panda_cosim.fmus.errors import CosimError
from panda_cosim.fmus.sources.targets import build

def tell(done, _):
    print(done, time.monotonic(), flush=True)

scenario, out, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
if "fmus" in options:
    options["fmus"] = build(("controller",)) | {k: Path(v) for k, v in options["fmus"].items()}
try:
    done = run_scenario(scenario, out, Options(**options), progress=tell)
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
    more = json.dumps({"fmus": {"plant": str(fmu)}, **options})
    return forked.script(RUN, str(scenario), str(out), more, FAULT=fault)


def processes_with(*words: str) -> Sequence[int]:
    """Return the numbers of living processes whose command line or environment has all words."""
    numbers = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            text = (entry / "cmdline").read_bytes() + (entry / "environ").read_bytes()
            if is_alive(int(entry.name)) and all(word.encode() in text for word in words):
                numbers.append(int(entry.name))
    return numbers
