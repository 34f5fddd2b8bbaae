"""The program around the commands: its options, exit codes and messages."""

from __future__ import annotations

import os
import re
import shutil
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from inspect import signature
from itertools import chain
from typing import Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from ..fmus.errors import CosimError, InputError, did_you_mean, excerpt
from ..fmus.twins import notice
from ..result.pictures.gl import load_no_backend
from . import INTERRUPTS, ending, exit_code, startup
from .commands import COMMANDS, ELSEWHERE, EPILOG, RULES
from .console import complain, show, warn
from .forms import described, flag

MIN_COLUMNS = 20  # of a terminal
HELP_COLUMNS = 80  # of a help text; in less, names of options would be cut off


class PlainFlags:
    """A command whose help shows flags as flags, without a type."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the arguments and options, `--help` included."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class Command(PlainFlags, TyperCommand):
    """One command, whose options keep the rules of commands.toml."""

    def invoke(self, ctx: Any) -> Any:
        """Check which options were given together, and call the function."""
        params = (p for p in self.params if ctx.params[p.name] not in (p.default, None, ()))
        given = {name for param in params for name in param.opts}
        for rule in RULES.get(str(self.name), ()):
            first, *others = re.findall("--[a-z-]+", rule)
            if first in given and given.isdisjoint(others) == ("needs" in rule):
                raise InputError(rule)
        return super().invoke(ctx)


class LazyCommand(TyperCommand):
    """Stands for a command in the program's help, and imports it when it is called."""

    def make_context(self, info_name: str | None, args: list[str], *more: Any, **extra: Any) -> Any:
        """Import the command and let it read its arguments."""
        name = str(self.name)
        if args and f"{name} {args[0]}" in ELSEWHERE:  # such as `sweep report`
            name, args = f"{name} {args[0]}", args[1:]
        if "--isolate" in args:
            startup.start_isolation()
        command = load(name)
        startup.imported()
        return command.make_context(name, args, *more, **extra)


@cache
def load(name: str) -> TyperCommand:
    """Import a command's module and return the command."""
    module, attribute = ELSEWHERE.get(name, f"{name}:command").split(":")
    function = getattr(import_module(f"{__package__}.commands.{module}"), attribute)
    alone = typer.Typer(add_completion=False, rich_markup_mode="markdown")
    alone.command(name, cls=Command, help=help_of(function))(function)
    command: TyperCommand = get_command(alone)  # type: ignore[assignment]
    return command


def help_of(function: Callable[..., object]) -> str:
    """Return the docstring of a command without the texts of its options, which are theirs now."""
    parameters = signature(function).parameters.items()
    return described({name: each.default for name, each in parameters}, function.__doc__)


class Program(PlainFlags, TyperGroup):
    """The group of all commands, which reports errors in one line and sets the exit code."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, (panel, summary) in COMMANDS.items():
            self.add_command(LazyCommand(name, help=summary, rich_help_panel=panel))

    def main(self, args: Sequence[str] | None = None, **extra: Any) -> NoReturn:  # type: ignore[override]
        """Run a command and exit."""
        words = list(sys.argv[1:] if args is None else args)
        # Accepted anywhere, so that users can append it to a failed command.
        debug = "--debug" in words
        extra["standalone_mode"] = False
        try:
            code = super().main([word for word in words if word != "--debug"], **extra) or 0
            ending.settle()
        except BaseException as error:  # also KeyboardInterrupt and SystemExit
            ending.settle()
            if debug:
                traceback.print_exc()
            # An import that a signal breaks off may fail with an error of its own.
            code = ending.code or report(error)
        startup.end()
        sys.exit(code)


def report(error: BaseException) -> int:
    """Print an error in one line and return its exit code."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, INTERRUPTS):
        return exit_code(error)
    code, message = _explain(error)
    notes = (getattr(each, "__notes__", ()) for each in (error.__cause__, error))
    for note in dict.fromkeys(chain.from_iterable(notes)):
        warn(note)
    complain(message)
    return code


def _explain(error: BaseException) -> tuple[int, str]:
    """Return the exit code and the line for an error."""
    match error:
        case CosimError():
            return error.exit_code, str(error)
        case ModuleNotFoundError():
            return 1, f"{error}; `panda-cosim doctor` shows what is missing and how to get it"
        case OSError() if error.filename is not None:
            return InputError.exit_code, f"{error.filename}: {error.strerror}"
        case OSError() | MemoryError():  # mostly a limit of the machine or the user
            reason = getattr(error, "strerror", None) or "out of memory"
            return 1, f"the operating system ends the command: {reason}"
    if hasattr(error, "format_message"):  # raised by typer or click
        return InputError.exit_code, _usage_message(error)
    return 1, (
        f"unexpected {type(error).__name__}: {error}; append --debug to the command to get the "
        f"traceback; {notice() or 'please report it'}"
    )


def _usage_message(error: Any) -> str:
    """Return typer's message, with the nearest valid choice and a pointer to the help."""
    message = str(error.format_message()).replace("Value error, ", "").rstrip(".")
    # pydantic's messages about numbers leave out the refused value.
    errors: list[Any] = getattr(error.__cause__, "errors", list)()
    if errors:
        rule = message.partition(", unable to parse")[0]
        message = rule.replace("Input should be", f"{excerpt(errors[0]['input'])}; must be", 1)
    if choice := re.search(r"'([^']*)' is not one of (.*)", message):
        message += did_you_mean(choice[1], re.findall("'(.*?)'", choice[2]))
    path = getattr(getattr(error, "ctx", None), "command_path", "panda-cosim")
    return f"{message} (see `{path} --help`)"


app = typer.Typer(
    name="panda-cosim",
    cls=Program,
    epilog=EPILOG,
    invoke_without_command=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def program(  # noqa: D417 - the context is no option
    context: typer.Context, version: bool = flag("--version"), debug: bool = flag("--debug")
) -> None:
    """FMI co-simulation of a Franka Emika Panda that picks up a block and sets it on a table.

    Start with `panda-cosim run`: it builds the two FMUs, couples them, prints the verdict and
    writes the results to a new folder in runs/. Open view.html in that folder to see the run.

    Args:
        version: Show the version.
        debug: Show the traceback of an error. Can stand anywhere in a command.
    """
    del debug  # `Program.main` takes it
    if version:
        from importlib.metadata import version as installed_version  # noqa: PLC0415 - slow

        show(f"panda-cosim {installed_version('panda-cosim')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.callback(help=help_of(program))(program)


def run_program() -> None:
    """Run the program and exit."""
    startup.environment()
    startup.keep_output()
    load_no_backend()
    for stream in (sys.stdout, sys.stderr):
        # A character that the terminal cannot encode must not end the program.
        getattr(stream, "reconfigure", dict)(errors="replace")
    columns = os.environ.get("COLUMNS", "80")
    if not (columns.isdecimal() and int(columns) >= MIN_COLUMNS):  # with 0, rich prints nothing
        del os.environ["COLUMNS"]
    if shutil.get_terminal_size().columns < HELP_COLUMNS:
        os.environ.setdefault("TERMINAL_WIDTH", str(HELP_COLUMNS))  # as typer calls it
    app(prog_name="panda-cosim")
