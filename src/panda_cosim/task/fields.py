"""Field types that check their values, and dataclasses that report errors in one line.

A scenario's classes declare the valid values of a field with the field:

    @checked
    class Push:
        start: Annotated[float, Quantity(0.0, 3600.0, "s")]

pydantic checks the fields. This module adds the types that it lacks (a number with bounds and a
unit, one of several names, one line of text) and turns its errors into one line with the place,
the value, the bound and the nearest valid name.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar, dataclass_transform, get_args, get_type_hints

import numpy as np
from pydantic import ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import CoreSchema, core_schema

from ..fmus.errors import InputError, excerpt, refuse, valid_names

T = TypeVar("T")
Loc = tuple[str | int, ...]
_MAX_TEXT = 200  # characters


class _Field:
    """Base of the field types: calling one returns the value to store, or raises ValueError."""

    def __call__(self, value: object) -> Any:
        raise NotImplementedError

    def check(self, place: str, value: object) -> Any:
        """Return the value to store."""
        try:
            return self(value)
        except ValueError as error:
            raise InputError(_joined(place, error)) from None

    def __get_pydantic_core_schema__(self, _: Any, __: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self)


@dataclasses.dataclass(frozen=True)
class Quantity(_Field):
    """A finite number within [low, high], with a unit; int and numpy's numbers become float."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def __call__(self, value: Any) -> float:
        """Return the number as a float."""
        number = math.nan
        if not isinstance(value, bool | str | bytes):
            with suppress(OverflowError, TypeError):  # of what is no number, or several
                number = float(value)
        if not (math.isfinite(number) and self.low <= number <= self.high):
            raise ValueError(f"value {excerpt(value)}; must be {self}")
        return number

    def __str__(self) -> str:
        finite = math.isfinite(self.low) and math.isfinite(self.high)
        bounds = f"a number from {self.low:g} to {self.high:g}" if finite else "a finite number"
        return f"{bounds} {'' if self.unit == '1' else self.unit}".rstrip()


@dataclasses.dataclass(frozen=True)
class Whole(_Field):
    """A whole number within [low, high]; one that is a float becomes an int."""

    low: int
    high: int

    def __call__(self, value: object) -> int:
        """Return the number."""
        number = Quantity()(value)
        if not (self.low <= number <= self.high and number == int(number)):
            must = f"must be a whole number from {self.low} to {self.high}"
            refuse("", value, must, error=ValueError)
        return int(number)


@dataclasses.dataclass(frozen=True)
class Vector(_Field):
    """A fixed number of numbers with the same bounds; stored as a tuple."""

    count: int
    item: Quantity = Quantity()

    def __call__(self, value: Any) -> tuple[float, ...]:
        """Return the numbers as floats."""
        is_list = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)
        if not is_list or len(value) != self.count:
            raise ValueError(f"value {excerpt(value)}; must be {self.count} numbers")
        return numbers(value, self.item)


@dataclasses.dataclass(frozen=True)
class Choice(_Field):
    """One of several names."""

    valid: Collection[str]

    def __call__(self, value: object) -> str:
        """Return the name."""
        if not isinstance(value, str) or value not in self.valid:
            valid = ", ".join(filter(None, self.valid))  # "" stands for none
            refuse("", value, f"must be one of {valid}", self.valid, ValueError)
        return value


class Line(_Field):
    """One line of printable text."""

    def __call__(self, value: object) -> str:
        """Return the text."""
        if not (isinstance(value, str) and len(value) <= _MAX_TEXT and value.isprintable()):
            refuse("", value, f"must be one line of at most {_MAX_TEXT} characters", (), ValueError)
        return value


class Value(_Field):
    """A parameter's value; name and bounds are checked against the FMU later."""

    def __call__(self, value: object) -> float | bool | str | tuple[float, ...]:
        """Return the value."""
        if isinstance(value, bool):
            return value
        if isinstance(value, str):
            return Line()(value)
        if isinstance(value, Mapping):
            raise ValueError("is a section; must be a value (a name with dots needs quotes)")
        if not isinstance(value, Sequence | np.ndarray):
            number = Quantity()(value)
            return int(value) if isinstance(value, int) and abs(value) > 2**53 else number
        return numbers(value, Quantity())


def numbers(values: Iterable[object], item: Quantity) -> tuple[float, ...]:
    """Return a sequence's items as floats; an error begins with the item's index, from 1."""
    checked_items = []
    for index, value in enumerate(values, 1):
        try:
            checked_items.append(item(value))
        except ValueError as error:
            raise ValueError(f"[{index}]: {error}") from None
    return tuple(checked_items)


def check_choice(place: str, value: object, valid: Collection[str]) -> str:
    """Return the value if it is one of the valid names."""
    return str(Choice(valid).check(place, value))


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def checked(cls: type[T]) -> type[T]:
    """Make a frozen dataclass whose fields check their values."""
    # A mapping given for a field that is such a class is made into one. Whatever cannot be used
    # raises an InputError; a `__post_init__` raises ValueError for what concerns several fields.
    config = ConfigDict(extra="forbid", validate_by_name=True, validate_by_alias=True)
    dataclass = pydantic_dataclass(frozen=True, config=config)(cls)
    plain = dataclass.__init__

    @functools.wraps(plain)
    def init(self: object, *args: object, **kwargs: object) -> None:
        try:
            plain(self, *args, **kwargs)
        except ValidationError as error:
            raise InputError(_describe(error, dataclass)) from None

    dataclass.__init__ = init  # type: ignore[method-assign]
    return dataclass  # type: ignore[return-value]  # a class of T's own fields


@contextmanager
def validated(place: object) -> Iterator[None]:
    """Refuse what a model of pydantic's refuses, by its first problem, in one line."""
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        raise InputError(": ".join(map(str, (place, *first["loc"], first["msg"])))) from None


def field_names(cls: Any) -> tuple[str, ...]:
    """Return the names of a dataclass's fields."""
    return tuple(entry.name for entry in dataclasses.fields(cls))


def check_rules(rules: Mapping[str, object]) -> None:
    """Raise the first message whose condition, a combination that is not allowed, holds."""
    for message, is_broken in rules.items():
        if is_broken:
            raise InputError(message)


def check_keys(
    place: str, keys: Collection[str], valid: Collection[str], kind: str = "key"
) -> None:
    """Refuse keys that are unknown."""
    for key in keys:
        if key not in valid:
            raise InputError(place + _unknown(key, valid, kind))


def _unknown(key: str, valid: Collection[str], kind: str = "key") -> str:
    return f"{kind} {excerpt(key)} is unknown; {valid_names(key, valid)}"


def _describe(error: ValidationError, cls: type) -> str:
    """Return what is wrong first, unknown keys before all, since they make others missing."""
    problems = error.errors(include_url=False)
    unknown = [p for p in problems if p["type"] == "unexpected_keyword_argument"]
    problem = (unknown or problems)[0]
    loc: Loc = problem["loc"]
    if unknown:
        names = field_names(_class_at(cls, loc[:-1]))
        valid = [name.removesuffix("_") for name in names]  # `from_` stands for `from`
        return _section(loc[:-1]) + _unknown(str(loc[-1]), valid)
    if problem["type"] == "missing":
        return f"{_section(loc[:-1])}key {loc[-1]} is missing"
    cause = problem.get("ctx", {}).get("error")
    is_section = _class_at(cls, loc) is not None or not loc
    if cause is None:  # something of another type
        path = ".".join(part for part in loc if isinstance(part, str))
        lists = f"sections [[{path}]]" if is_section else 'a list of texts, ["...", ...]'
        forms = {"bool_type": "true or false", "tuple_type": lists}
        form = forms.get(problem["type"], f"a section [{path}]")
        return f"{_section(loc[:-1])}key {loc[-1]}: must be {form}"
    return f"{_section(loc)}{cause}" if is_section else _joined(_place(loc), cause)


def _joined(place: str, cause: ValueError) -> str:
    """Return an error with its place before it: "force[1]: ..." where it begins with an index."""
    return f"{place}{cause}" if str(cause).startswith("[") else f"{place}: {cause}"


def _class_at(cls: Any, loc: Loc) -> Any:
    """Follow a location through the field types; None where it ends at no dataclass."""
    for name in loc:
        if isinstance(name, str) and cls is not None:
            hint = get_type_hints(cls).get(name)
            kinds = (hint, *get_args(hint))
            cls = next((kind for kind in kinds if dataclasses.is_dataclass(kind)), None)
    return cls


def _section(loc: Loc) -> str:
    """Return "[success] ", "[[push]] 2: " or "" for the file's top."""
    name = ".".join(part for part in loc if isinstance(part, str))
    counts = [part + 1 for part in loc if isinstance(part, int)]
    if counts:
        return f"[[{name}]] {counts[-1]}: "
    return f"[{name}] " if name else ""


def _place(loc: Loc) -> str:
    """Return "duration", "[success] max_tilt" or "[[push]] 2: force[1]"."""
    end = len(loc)
    while end and isinstance(loc[end - 1], int):
        end -= 1
    indices = "".join(f"[{int(part) + 1}]" for part in loc[end:])
    return f"{_section(loc[: end - 1])}{loc[end - 1]}{indices}"
