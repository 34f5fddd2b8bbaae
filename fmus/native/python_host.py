"""Runs inside an FMU, between the FMI layer in C and a slave class in Python.

It is one file, since an FMU carries it as a resource and the library executes it before anything
can be imported, in a namespace of its own, with

    VALUES     memory of all values, by value reference
    RESOURCES  folder of the resources

and calls the functions below. Each returns None or a list of log messages (status, text); the worst
status is that of the FMI call. A step that is discarded ends the simulation where it begins.

A slave is a class on PythonFMU's interface, `pythonfmu.Fmi2Slave`. Its variables are set and got by
their references, as PythonFMU does. A class that has `share_values` is faster: it works on the
memory itself, and has

    share_values(values, texts)  memoryview of doubles, dict of texts, both by value reference
    start(start_time)            make the model from the parameters, write the outputs of the start
    initialized(), terminate()   initialization has ended, no step follows; both may be missing
    tune()                       apply changed tunable parameters; may be missing
    advance(count)               take internal steps, write the outputs
    get_state() -> bytes         the state besides the values
    set_state(state)             restore it; the values are restored before
    messages                     list of (status, text), emptied after each call
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import threading
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

OK, WARNING, DISCARD, ERROR = range(4)
PATHS_VARIABLE = "PANDA_COSIM_PYTHONPATH"
VALUES: memoryview[float] = globals()["VALUES"].cast("d")
RESOURCES: str = globals()["RESOURCES"]
PYTHON_IS_OURS = hasattr(sys, "_started_by_fmu")  # by this one or another; the library sets it
Message = tuple[int, str]
messages: list[Message] = []
texts: dict[int, str] = {}  # values of all String variables, by value reference
slave: Any = None


class Table:
    """What resources/variables.txt says: options, and references of variables by their kinds."""

    def __init__(self) -> None:
        self.options: dict[str, list[str]] = defaultdict(list)
        self.given: dict[str, list[int]] = defaultdict(list)  # the importer sets them
        self.computed: dict[str, list[int]] = defaultdict(list)  # the slave does
        for line in Path(RESOURCES, "variables.txt").read_text(encoding="utf-8").splitlines():
            match line.split("\t"):
                case ["option", key, value]:
                    self.options[key].append(unquote(value))
                case ["variable", reference, _, causality, variability, kind, *_]:
                    kind = "integer" if kind == "Enumeration" else kind.lower()
                    is_given = causality in {"input", "parameter"} and variability != "constant"
                    if causality != "independent":
                        (self.given if is_given else self.computed)[kind].append(int(reference))


# ---- packages that the slave needs


class PackageError(Exception):
    """A package is missing or too old; the message says what to do."""


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".")[:3] if part.isdigit())


def recorded_folders(options: dict[str, list[str]], needs: Sequence[str]) -> list[str]:
    """The folders with packages of the Python that built the FMU, if they are of use here."""
    same = options.get("version") == ["{}.{}".format(*sys.version_info[:2])]
    missing = not all(name in sys.modules or importlib.util.find_spec(name) for name in needs)
    return options.get("path", []) if same and (PYTHON_IS_OURS or missing) else []


def check_need(name: str, minimum: str) -> None:
    """Check that a package is there and new enough."""
    was_loaded = name in sys.modules
    try:
        found = str(getattr(importlib.import_module(name), "__version__", "0"))
    except Exception as error:  # a package that does not fit its neighbours raises anything
        reason = " ".join(str(error).split())
        raise PackageError(f"the package {name} cannot be imported: {reason}") from error
    if minimum != "*" and _version(found) < _version(minimum):
        where = getattr(sys.modules[name], "__file__", "")
        already = "; this process had loaded it already" if was_loaded else ""
        raise PackageError(f"{name} {found} ({where}) is too old, {minimum} is needed{already}")


@contextmanager
def packages(options: dict[str, list[str]]) -> Iterator[None]:
    """Make the required packages importable while the slave is imported."""
    # Afterwards a host's search path is restored; a Python that the FMU started keeps the folders.
    needs = [need.split() for need in options.get("need", [])]
    before = list(sys.path)
    chosen = list(filter(None, os.environ.get(PATHS_VARIABLE, "").split(os.pathsep)))
    extra = chosen or recorded_folders(options, [name for name, _ in needs])
    folders = [folder for folder in extra if folder not in before]
    sys.path[:] = [*folders, *before] if PYTHON_IS_OURS or chosen else [*before, *folders]
    try:
        with without_opengl() if PYTHON_IS_OURS else nullcontext():
            for name, minimum in needs:
                check_need(name, minimum)
            yield
    finally:
        if not PYTHON_IS_OURS:
            sys.path[:] = [folder for folder in sys.path if folder not in folders]


@contextmanager
def without_opengl() -> Iterator[None]:
    """Keep MuJoCo's import from starting a process, which would be the host once more."""
    opengl = {n: value for n, value in os.environ.items() if n == "MUJOCO_GL"}
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
        os.environ.update(opengl)


# ---- the FMU's own code


@contextmanager
def first_on_path(folder: str) -> Iterator[None]:
    """Import from a folder before any other."""
    importlib.invalidate_caches()
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def _of(names: Sequence[str]) -> dict[str, ModuleType]:
    return {key: m for key, m in sys.modules.items() if key.partition(".")[0] in names}


@contextmanager
def private_modules(package: str, names: Sequence[str]) -> Iterator[None]:
    """Make the FMU's own modules importable by their names, hidden from all other code."""
    # Afterwards they are in `sys.modules` below the package's name, which is unique to the FMU.
    of_host = _of(names)
    for key in of_host:
        del sys.modules[key]
    try:
        with first_on_path(f"{RESOURCES}/{package}"):
            yield
    finally:
        for key in _of(names):
            sys.modules[f"{package}.{key}"] = sys.modules.pop(key)
        sys.modules.update(of_host)


def import_class(options: dict[str, list[str]]) -> Any:
    """Import and return the slave's class."""
    package = options["package"][0]
    module, _, name = options["slave"][0].partition(" ")
    private = options.get("private", [])
    whole = f"{package}.{module}"
    with first_on_path(RESOURCES):
        importlib.import_module(package)
    if module.partition(".")[0] not in private:
        importlib.import_module(whole)
    elif whole not in sys.modules:
        with private_modules(package, private):
            importlib.import_module(module)
    return getattr(sys.modules[whole], name)


# ---- the slave


class PythonFmu:
    """A slave whose variables are set and read by reference, as in PythonFMU's library.

    It has methods as one that works in the values' memory.
    """

    def __init__(self, make: Callable[[], Any], table: Table) -> None:
        self.make, self.table = make, table
        self.messages: list[Message] = []
        self.slave = make()
        self.known: dict[str, list[Any]] = {}

    def start(self, start_time: float) -> None:
        """Make a new object, since its parameters may have changed."""
        self.slave = self.make()
        self.known = {}
        self.slave.setup_experiment(start_time, None, None)
        self._put()
        self.slave.enter_initialization_mode()
        self._put(again=True)
        self.slave.exit_initialization_mode()
        self.outputs()

    def do_step(self, time: float, size: float) -> None:
        """Take one communication step; parameters are set before it."""
        self._put()
        try:
            if not self.slave.do_step(time, size):
                raise StepError("do_step returned False")
        finally:  # the slave may have logged why it failed, or discards the step
            self._take_messages(DISCARD)

    def outputs(self) -> None:
        """Read all outputs and local variables from the slave."""
        self._put()
        for kind, references in self.table.computed.items():
            into: Any = texts if kind == "string" else VALUES
            convert = str if kind == "string" else float
            values = getattr(self.slave, f"get_{kind}")(references)
            for reference, value in zip(references, values, strict=True):
                into[reference] = convert(value)
        self._take_messages()

    def _put(self, again: bool = False) -> None:
        for kind, references in self.table.given.items():
            values = self._values(kind, references)
            if again or values != self.known.get(kind):
                getattr(self.slave, f"set_{kind}")(references, values)
                self.known[kind] = values

    def _values(self, kind: str, references: list[int]) -> list[Any]:
        convert = {"real": float, "integer": int, "boolean": bool, "string": str}[kind]
        values: Any = texts if kind == "string" else VALUES
        return [convert(values[reference]) for reference in references]

    def _take_messages(self, kept: int = WARNING) -> None:
        for entry in self.slave.log_queue:
            status = int(getattr(entry.status, "value", entry.status))
            self.messages.append((kept if status == kept else min(status, WARNING), str(entry.msg)))
        self.slave.log_queue.clear()

    def get_state(self) -> bytes:
        """Return the state, which PythonFMU serialises as JSON."""
        return bytes(self.slave._fmu_state_to_bytes(self.slave._get_fmu_state()))

    def set_state(self, state: bytes) -> None:
        """Restore a state, which includes the values that were set last."""
        self.slave._set_fmu_state(self.slave._fmu_state_from_bytes(state))
        self.known = {kind: self._values(kind, vrs) for kind, vrs in self.table.given.items()}

    def terminate(self) -> None:
        """Terminate the slave."""
        self.slave.terminate()
        self._take_messages()


class StepError(Exception):
    """The slave reported a failure; its message needs no traceback."""


def make_slave() -> Any:
    """Import the class and instantiate it; in the values' memory if it can work there."""
    table = Table()
    texts.update(dict.fromkeys(sorted(table.given["string"] + table.computed["string"]), ""))
    # Of the whole process, since imports change state that is shared by all threads.
    lock = sys.__dict__.setdefault("_fmu_import_lock", threading.RLock())
    with lock, packages(table.options):
        slave_class = import_class(table.options)

        def make() -> Any:
            return slave_class(instance_name="fmu", resources=RESOURCES, visible=False)

        if not hasattr(slave_class, "share_values"):
            return PythonFmu(make, table)
        made = make()
        made.share_values(VALUES, texts)
        return made


# ---- what the library calls


def explain(error: BaseException) -> str:
    """Return the text of an error, with the traceback unless the message suffices."""
    if isinstance(error, (StepError, PackageError, ValueError)) and str(error):
        return str(error)
    return "".join(traceback.format_exception(error)).rstrip()


def call(method: str, *arguments: Any) -> list[Message] | None:
    """Call a method of the slave, if it has it, and return its messages since the last call."""
    try:
        getattr(slave, method, lambda: None)(*arguments)
    except BaseException as error:  # no exception may reach the C library
        slave.messages.append((ERROR, explain(error)))
    if not slave.messages:
        return None
    taken = list(slave.messages)
    slave.messages.clear()
    return taken


start, initialized, tune, set_state, terminate = (
    partial(call, method) for method in ("start", "initialized", "tune", "set_state", "terminate")
)


def step(count: int, time: float, size: float) -> list[Message] | None:
    """Take internal steps, or a communication step of PythonFMU's."""
    if isinstance(slave, PythonFmu):
        return call("do_step", time, size)
    return call("advance", count)


def take_texts(given: list[str]) -> None:
    """Set the texts of all String variables, in the order of value references."""
    texts.update(zip(texts, given, strict=True))


def give_texts() -> list[str]:
    """Return the texts of all String variables, in the order of value references."""
    return list(texts.values())


def get_state() -> bytes | list[Message]:
    """Return the slave's state."""
    try:
        return bytes(slave.get_state())
    except BaseException as error:
        return [(ERROR, explain(error))]


def release() -> None:
    """Drop all references, since the memory of the values is about to be freed."""
    globals().clear()


try:
    slave = make_slave()
except BaseException as error:
    where = f"Python {sys.version.split()[0]} ({sys.prefix})"
    text = f"the FMU's code cannot start in {where}: {explain(error)}. If its packages are in "
    text += f"another folder, set {PATHS_VARIABLE} to the folder that holds them before it starts."
    messages.append((ERROR, text))
# A step in shared memory writes them.
outputs = partial(call, "outputs") if isinstance(slave, PythonFmu) else None
