"""The project's errors, the exit code of each, and the text in their messages.

Text is on one line, printable, with the nearest valid name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, Final, NoReturn
from unicodedata import category

EXCERPT_LENGTH: Final = 60  # [character] a longer value would bury the message
LINE_LENGTH: Final = 300  # [character] of other programs' messages
TEXT_LENGTH: Final = 1000  # [character] of one text on a page
HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})  # Unicode categories


def printable(text: str) -> str:
    """Return text with line breaks and control characters escaped."""
    # File names and messages of FMUs may contain any, and a terminal would act on them.
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def one_line(said: object) -> str:
    """Return foreign text, or an exception's message, as one printable line."""
    words = " ".join(str(said)[: 4 * LINE_LENGTH].split())[:LINE_LENGTH]
    return printable(words) or (type(said).__name__ if isinstance(said, BaseException) else "")


def excerpt(value: object) -> str:
    """Show a value on one line, shortened."""
    if isinstance(value, str):
        value = value[: EXCERPT_LENGTH + 1]
    elif isinstance(value, int) and value.bit_length() > 256:
        return f"an integer of {value.bit_length()} bits"  # Python cannot print the largest
    text = ascii(value)
    return text if len(text) <= EXCERPT_LENGTH else f"{text[: EXCERPT_LENGTH - 3]}..."


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name that is nearest to a mistyped one, or None if none is near."""
    lowered = {candidate.lower(): candidate for candidate in valid}
    near = get_close_matches(name[:EXCERPT_LENGTH].lower(), lowered, n=1)
    return lowered[near[0]] if near else None


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" to append to a message, or "" if no valid name is near."""
    near = nearest(name, valid)
    return f"; did you mean {near!r}?" if near else ""


def valid_names(name: str, valid: Collection[str]) -> str:
    """Return "valid: x, y; did you mean 'x'?" to append to a message about a mistyped name."""
    return f"valid: {', '.join(valid) or 'none'}{did_you_mean(name, valid)}"


def legible(text: str, limit: int | None = None) -> str:
    """Return foreign text for a page, with characters that are not seen written as escapes."""
    # Control characters and marks of direction could turn the page's own words around, and HTML
    # cannot hold all of them. Line breaks and tabs stay, and so do the joiners that scripts need.
    if limit is not None and len(text) > limit:
        text = f"{text[: limit - 1]}…"
    if text.isprintable():
        return text
    return "".join(_seen(char) for char in text.replace("\r\n", "\n"))


def shown(value: object, limit: int | None = TEXT_LENGTH) -> object:
    """Return a text as a page shows it, see `legible`; anything else, and HTML, as it is."""
    return legible(value, limit) if type(value) is str else value


def _seen(char: str) -> str:
    is_hidden = category(char) in HIDDEN and char not in "\n\t\u200c\u200d"
    return ascii(char)[1:-1] if is_hidden else char


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


def refuse(
    place: str,
    value: object,
    must: str,
    near: Iterable[str] = (),
    error: type[Exception] = InputError,
) -> NoReturn:
    """Refuse a value in the words of every such message: place, value, what it must be.

    Args:
        place: Where it stands, from the outside in: "file: section: key"; "": the caller adds it.
        value: What was found there; it is shown on one line, shortened.
        must: What would be valid, with bound and unit: "must be above 0 s".
        near: The valid names; the one that is nearest to the value is proposed.
        error: ValueError where the caller adds file and section.

    Raises:
        InputError: Always, or `error`.
    """
    hint = did_you_mean(str(value), near)
    where = f"{place}: " if place else ""
    raise error(f"{where}value {excerpt(value)}; {must}{hint}")


@contextmanager
def located(place: object) -> Iterator[None]:
    """Put a place (a file, a line, a key) before the message of what is refused within."""
    try:
        yield
    except (InputError, ValueError) as error:
        raise InputError(f"{place}: {error}") from None


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
        super().__init__(message)
        self.message = message
        self.time = time
        self.instance = instance
        self.variable = variable

    def __str__(self) -> str:
        """Time, instance and variable, as far as they are known, and the message."""
        where = [f"at t = {self.time:.3f} s"] if self.time is not None else []
        if self.instance:
            where.append(f"in FMU {self.instance!r}")
        if self.variable:
            where.append(f"variable {self.variable}")
        return printable(f"{', '.join(where)}: {self.message}" if where else self.message)


class SimulationEndedError(SimulationError):
    """An FMU has ended the simulation, as FMI allows it to; `reached` is its last instant [s]."""

    def __init__(self, message: str, *, reached: float = 0.0, **where: Any) -> None:
        super().__init__(message, **where)
        self.reached = reached
