"""The project's errors, and the exit code of each."""

from __future__ import annotations

from .messages import printable


class CosimError(Exception):
    """Base of all errors that are reported to the user in one line."""

    exit_code = 1


class InputError(CosimError):
    """Bad input: a file, an option or a value that cannot be used.

    The message is one line that names the file, the place in it, the value, the bound and
    what would be valid.
    """

    exit_code = 2

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class SimulationError(CosimError):
    """A simulation that failed while it ran.

    Attributes:
        message: What failed, without time, instance and variable.
        time: Simulated time of the failure [s], or None before the first step.
        instance: Name of the FMU instance that failed, or "".
        variable: Name of the variable that was involved, or "".
    """

    def __init__(
        self, message: str, *, time: float | None = None, instance: str = "", variable: str = ""
    ) -> None:
        where = [f"at t = {time:.3f} s"] if time is not None else []
        if instance:
            where.append(f"in FMU {instance!r}")
        if variable:
            where.append(f"variable {variable}")
        super().__init__(printable(f"{', '.join(where)}: {message}" if where else message))
        self.message = message
        self.time = time
        self.instance = instance
        self.variable = variable
