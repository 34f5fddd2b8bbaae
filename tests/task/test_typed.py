"""What users call from Python refuses arguments of a wrong type in one line."""

from collections.abc import Iterator
from inspect import Parameter, isfunction, ismethod, signature
from typing import Any

import numpy as np
import pytest

import panda_cosim
from panda_cosim import Options, Session, load_scenario
from panda_cosim.task.typed import typed
from refusals import refused

SPECIAL = ("__init__", "__getitem__")
CLASSES = ("Recording", "Run", "Session")
ANY = ("coupling", "changes")  # whose values the call itself refuses


def calls() -> Iterator[Any]:
    """Yield each public function and method, with a parameter of its."""
    for name in panda_cosim.__all__:
        public = getattr(panda_cosim, name)
        members = vars(public).items() if name in CLASSES else ()
        methods = [getattr(public, n) for n, member in members if n[0] != "_" or n in SPECIAL]
        named = [getattr(public, n) for n in ("read", "changed") if name in ("Scenario", "Sweep")
                 and hasattr(public, n)]  # fmt: skip
        for call in [public, *methods, *named]:
            if not (isfunction(call) or ismethod(call)):
                continue
            for parameter in signature(call).parameters.values():
                is_given = parameter.kind in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
                if not is_given and parameter.name not in ("self", *ANY):
                    yield pytest.param(
                        call, parameter.name, id=f"{call.__qualname__}-{parameter.name}"
                    )


@pytest.mark.parametrize(("call", "name"), [*calls()])
def test_an_argument_of_a_wrong_type_is_refused_with_its_name(call, name):
    message = refused(call, **{name: object()})
    assert message.startswith(f"{call.__qualname__}: {name}: value <object")
    assert "; must be of type " in message


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"log": "plant"}, "Options: log: value 'plant'; must be of type Sequence"),
        ({"fmus": 5}, "Options: fmus: value 5; must be of type Mapping or None"),
    ],
)
def test_options_of_a_wrong_type_are_refused(given, words):
    assert refused(Options, **given) == words


def test_items_are_checked_and_texts_are_no_sequences():
    assert "values: value {5: 1}" in refused(load_scenario("push").changed, {5: 1})

    @typed
    def measure(signals: list[str] | None, *more: int, gain: float = 1.0, n: int = 1) -> object:
        return signals, more, gain, n

    assert measure(None, 1, 2, gain=np.float64(2.0), n=np.int64(3)) == (None, (1, 2), 2.0, 3)
    assert "measure: n: value 1.5; must be of type int" in refused(measure, None, n=1.5)
    assert refused(Session.set, value={}).endswith(
        "must be of type float or bool or str or Sequence"
    )
