"""Commands from a page to the simulation: small JSON objects, checked here."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ...fmus.errors import InputError
from ...fmus.master.step import Coupling

Name = Annotated[str, Field(max_length=100)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Place = Annotated[Number, Field(ge=-10.0, le=10.0)]  # [m]
Vector = Annotated[list[Number], Field(max_length=16)]


class _Command(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Play(_Command):
    """Run, pause, or restart."""

    do: Literal["play", "pause", "restart"]


class Step(_Command):
    """Take some ticks, then pause."""

    do: Literal["step"]
    ticks: Annotated[int, Field(ge=1, le=1000)]


class Speed(_Command):
    """Run at a speed relative to the wall clock."""

    do: Literal["speed"]
    factor: Annotated[Number, Field(ge=0.01, le=10.0)]


class Set(_Command):
    """Set a tunable parameter, or hold an input; `Session.set`."""

    do: Literal["set"]
    name: Name
    value: bool | Number | Annotated[str, Field(max_length=100)] | Vector


class Release(_Command):
    """Release a held input; `Session.release`."""

    do: Literal["release"]
    name: Name


class LetGo(_Command):
    """Release all held forces: the user who pushed has left."""

    do: Literal["let_go"]


class MoveWaypoint(_Command):
    """Move a later row of the table to another position in the world [m]."""

    do: Literal["waypoint"]
    row: Annotated[int, Field(ge=0, le=100_000)]
    position: Annotated[list[Place], Field(min_length=3, max_length=3)]


class Keep(_Command):
    """Write the session so far as a scenario, into a new folder in the working directory."""

    do: Literal["keep"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]


class SetCoupling(_Command):
    """Change the coupling; `Session.set_coupling`."""

    do: Literal["coupling"]
    coupling: Coupling


Command = Annotated[
    Play | Step | Speed | Set | Release | LetGo | MoveWaypoint | Keep | SetCoupling,
    Field(discriminator="do"),
]
_ADAPTER: TypeAdapter[Command] = TypeAdapter(Command)


def parse_command(text: str | bytes) -> Command:
    """Read a command."""
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"command: {place}: {first['msg']}") from None
