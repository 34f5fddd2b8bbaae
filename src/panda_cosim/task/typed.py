"""Arguments of what users call from Python: those of a wrong type are refused in one line."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from importlib import import_module
from types import FunctionType, SimpleNamespace, UnionType
from typing import Any, Final, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from ..fmus.errors import refuse

T = TypeVar("T", bound=Callable[..., Any])
# What counts as a type, numpy's among it.
_COUNTS: Final[Mapping[object, Any]] = {
    float: numbers.Real, int: numbers.Integral, Sequence: (Sequence, np.ndarray)
}  # fmt: skip


def typed(target: T) -> T:
    """Let a function, or the public methods of a class, refuse arguments of other types.

    Raises:
        InputError: An argument has another type than its annotation says.
    """
    if isinstance(target, type):
        for name, member in [*vars(target).items()]:
            is_public = name[0] != "_" or name in ("__init__", "__getitem__")
            if is_public and isinstance(member, FunctionType):
                setattr(target, name, typed(member))
            elif is_public and isinstance(member, classmethod):
                setattr(target, name, classmethod(typed(member.__func__)))
        return target
    code = cast("FunctionType", target).__code__
    names = code.co_varnames[: code.co_argcount]  # of those that may be given by place

    @wraps(target)
    def call(*given: Any, **named: Any) -> Any:
        check_types(target, dict(zip(names, given, strict=False)) | named)
        return target(*given, **named)

    return cast("T", call)


def check_types(target: Any, values: Mapping[str, object]) -> None:
    """Refuse values whose types are not those of a function's or class's annotations."""
    hints = _hints(target)
    for name, value in values.items():
        kinds = _kinds(hints.get(name, Any))
        if not any(_fits(value, kind) for kind in kinds):
            words = " or ".join(kind.__name__ for kind in kinds).replace("NoneType", "None")
            refuse(f"{target.__qualname__}: {name}", value, f"must be of type {words}")


def _kinds(hint: Any) -> tuple[Any, ...]:
    """Return the types of which one is enough."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


@cache
def _hints(target: Any) -> dict[str, Any]:
    given = {name: hint for name, hint in target.__annotations__.items() if name != "return"}
    scope = vars(import_module(target.__module__))
    return get_type_hints(SimpleNamespace(__annotations__=given), scope)


def _fits(value: object, hint: Any) -> bool:
    """Whether a value has a type; words and bounds are checked where they are used."""
    kind = get_origin(hint) or hint
    if kind in (Any, Literal):
        return True
    if not isinstance(value, _COUNTS.get(kind, kind)) or isinstance(value, str) > (kind is str):
        return False  # a text is no sequence of letters
    if kind not in (Sequence, Mapping):
        return True
    items = _kinds(get_args(hint)[0])  # or keys, as those who take values have better messages
    return all(any(_fits(each, item) for item in items) for each in cast("Iterable[Any]", value))
