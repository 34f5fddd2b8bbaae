"""The slave inside a law's FMU: calls the law's `update` once per period.

This file is copied into the FMU and needs only numpy. It works directly in the memory of all
values, as fmus/native/python_host.py describes.
"""

from __future__ import annotations

import json
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

LAW: Any = None  # the law's class; the FMU's copy of this file ends with an import that sets it
CONTAINERS: dict[str, Callable[[list[Any]], Any]] = {
    "list": list, "tuple": tuple, "set": set, "deque": deque, "dict": dict,
}  # fmt: skip


class LawSlave:
    """Calls a law with its inputs, and writes the returned `ctrl`."""

    def __init__(self, instance_name: str, resources: str, visible: bool = False) -> None:
        self.messages: list[tuple[int, str]] = []
        layout = json.loads(Path(resources, "layout.json").read_text(encoding="utf-8"))
        self._variables, self._start = layout["variables"], layout["start"]
        self._step = float(layout["step"])
        self._first = layout["first"]  # what the first `ctrl` must be like
        self._rates = layout["rates"]  # most by which `ctrl` changes [1/s]; None: any
        self._law: Any = None
        self._ticks, self._start_time = 0, 0.0

    def share_values(self, values: Any, texts: Any) -> None:
        """Make views of all variables in the memory."""
        memory, first = np.frombuffer(values, dtype=np.float64), 0
        self._inputs: dict[str, Any] = {}
        self._parameters: dict[str, tuple[Any, bool]] = {}
        for variable in self._variables:
            name, size = variable["name"], variable["size"]
            view = memory[first : first + size].reshape(variable["shape"])
            first += size
            if variable["causality"] == "input":
                self._inputs[name] = view
            elif variable["causality"] == "parameter":
                self._parameters[name] = (view, variable["is_switch"])
            else:
                self._ctrl = view

    def start(self, start_time: float) -> None:
        """Make the law from its parameters; `ctrl` starts at the plant's start value."""
        self._law = LAW()
        self._ticks, self._start_time = 0, start_time
        self.tune()
        if callable(getattr(self._law, "start", None)):
            self._law.start()
        self._ctrl[...] = np.reshape(self._start, self._ctrl.shape)

    def tune(self) -> None:
        """Set the law's parameters."""
        for name, (view, is_switch) in self._parameters.items():
            setattr(self._law, name, bool(view) if is_switch else _value(view))

    def advance(self, count: int) -> None:
        """Take internal steps; the law is updated once per period, at the beginning of a step."""
        period = max(round(getattr(self._law, "period", self._step) / self._step), 1)
        for _ in range(count):
            if self._ticks % period == 0:
                self._update(self._start_time + self._ticks * self._step, period * self._step)
            self._ticks += 1

    def _update(self, time: float, since: float) -> None:
        given = {name: _value(view) for name, view in self._inputs.items()}
        try:
            answer = self._law.update(time, **given)
        except Exception as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(frame.filename).name}, line {frame.lineno}"
            text = f"update failed: {place}: {type(error).__name__}: {error}"
            raise ValueError(text) from error
        try:
            ctrl = np.asarray(answer, dtype=np.float64)
        except (TypeError, ValueError):
            text = f"{LAW.__module__}.py: update returned {ascii(answer)[:60]}; must be numbers"
            raise ValueError(text) from None
        if ctrl.shape != self._ctrl.shape:
            raise ValueError(f"update: ctrl of shape {ctrl.shape}; must be {self._ctrl.shape}")
        if not np.isfinite(ctrl).all():
            raise ValueError(f"update: ctrl at t = {time:.3f} s is not finite: {ctrl}")
        if self._first and self._ticks == 0:
            low, high = self._first["low"], self._first["high"]
            arm = ctrl[: len(low)]
            if bool(((arm >= low) & (arm <= high)).all()) != self._first["within"]:
                raise ValueError(
                    f"update: ctrl starts with {arm.round(2)}; {self._first['reason']}"
                )
        if self._rates and self._ticks:
            most = np.multiply(self._rates, since)
            ctrl = np.clip(ctrl, self._ctrl - most, self._ctrl + most)
        self._ctrl[...] = ctrl

    def get_state(self) -> bytes:
        """The law's attributes and the time, as JSON."""
        attributes = {name: _written(name, value) for name, value in vars(self._law).items()}
        return json.dumps([self._ticks, self._start_time, attributes]).encode()

    def set_state(self, state: bytes) -> None:
        """Restore what `get_state` returned; nothing in it is run."""
        self._ticks, self._start_time, attributes = json.loads(state)
        vars(self._law).clear()
        vars(self._law).update({name: _read(value) for name, value in attributes.items()})


def _written(name: str, value: Any) -> Any:
    """An attribute's value for JSON, of numbers, texts, arrays and containers of them."""
    kind = type(value).__name__
    if value is None or type(value) in (bool, int, float, str):
        return value
    if (kind == "ndarray" or isinstance(value, np.generic)) and value.dtype.kind in "biufc":
        order = "F" if value.flags.fnc else "C"  # BLAS rounds differently for each
        return {"array": [value.dtype.str, value.shape, order, value.tobytes(order).hex()],
                "scalar": isinstance(value, np.generic)}  # fmt: skip
    if type(value) is CONTAINERS.get(kind):
        parts = map(list, value.items()) if kind == "dict" else value
        return {kind: [_written(name, part) for part in parts],
                "longest": value.maxlen if kind == "deque" else None}  # fmt: skip
    raise ValueError(
        f"the law's state cannot be saved: self.{name} holds a {kind}; must be numbers, texts, "
        "arrays, lists, tuples, sets, dictionaries or deques"
    )


def _read(value: Any) -> Any:
    """The value that `_written` was given."""
    if not isinstance(value, dict):
        return value
    kind, content = next(iter(value.items()))
    if kind == "array":
        dtype, shape, order, numbers = content
        array = np.frombuffer(bytes.fromhex(numbers), dtype).reshape(shape, order=order).copy("K")
        return array[()] if value["scalar"] else array
    parts = [_read(part) for part in content]
    return deque(parts, value["longest"]) if kind == "deque" else CONTAINERS[kind](parts)


def _value(view: Any) -> Any:
    """Return a value for the law: a number or a copy of an array."""
    return view.copy() if view.shape else float(view)
