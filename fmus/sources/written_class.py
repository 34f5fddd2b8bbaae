"""A class of a script or a notebook, written as a file: its source, and what that names."""

from __future__ import annotations

import ast
import inspect
import linecache
import sys
from collections.abc import Mapping
from hashlib import sha256
from itertools import chain
from textwrap import dedent
from types import FunctionType
from typing import Any

from ..atomic import cache_folder, cached
from ..errors import InputError


def file_of(given: type) -> str:
    """Return FILE.py:CLASS for a class; one that cannot be imported is written into the cache.

    A script would run again if it were imported, and a notebook has no file.

    Raises:
        InputError: Its source is not there, or it uses something that cannot be written.
    """
    name, module = given.__name__, sys.modules[given.__module__]
    file = getattr(module, "__file__", None)
    if given.__module__ != "__main__" and given.__qualname__ == name and file:
        return f"{file}:{name}"
    texts: dict[str, str] = {}
    _add(name, vars(module) | {name: given}, given.__module__, texts)
    text = "\n\n".join(["from __future__ import annotations", *texts.values()]) + "\n"
    folder = cache_folder() / "classes" / sha256(text.encode()).hexdigest()[:16]
    return f"{cached(folder / f'{name}.py', text.encode)}:{name}"


def _add(name: str, scope: Mapping[str, Any], module: str, texts: dict[str, str]) -> None:
    """Add what defines a name, after what it needs itself."""
    value, texts[name] = scope[name], ""  # so that a circle ends
    if inspect.ismodule(value):
        text = f"import {value.__name__} as {name}"
    elif hasattr(value, "__name__") and value.__module__ != module:
        text = f"from {value.__module__} import {value.__name__} as {name}"
    elif isinstance(value, type | FunctionType):
        text = _source(value)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Name) and node.id in scope and node.id not in texts:
                _add(node.id, scope, module, texts)
    else:
        text = f"{name} = {_literal(name, value)}"
    del texts[name]
    texts[name] = text


def _literal(name: str, value: Any) -> str:
    """Return a value as Python's source."""
    if type(value).__module__ == "numpy":
        return f"__import__('numpy').array({value.tolist()!r}, {value.dtype.str!r})"
    try:
        ast.literal_eval(repr(value))
    except (ValueError, SyntaxError):
        must = "must be a number, a text, an array or a container of them, or the class in a file"
        kind = type(value).__name__
        raise InputError(f"controller: uses {name} of type {kind}; {must}") from None
    return repr(value)


def _source(value: type | FunctionType) -> str:
    """Return the source of a function, or of a class by that of its methods; also of a notebook."""
    members = chain([value], vars(value).values())
    codes = (member.__code__ for member in members if isinstance(member, FunctionType))
    lines = linecache.getlines(next((code.co_filename for code in codes), ""))
    for node in ast.walk(ast.parse("".join(lines))):
        kind = ast.ClassDef if isinstance(value, type) else ast.FunctionDef
        if isinstance(node, kind) and node.name == value.__name__:
            first = min(each.lineno for each in (node, *node.decorator_list))
            return dedent("".join(lines[first - 1 : node.end_lineno]))
    raise InputError(f"controller: the source of {value.__name__} is not known; must be in a file")
