"""The commands: NAME is the function `command` in NAME.py, and a line in commands.toml.

`panda-cosim --help` reads only that table. A command's module is imported when the command is
called, so it can import everything at its top.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

_TABLES: Final = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
COMMANDS: Final[Mapping[str, tuple[str, str]]] = _TABLES["commands"]  # panel and summary by name
ELSEWHERE: Final[Mapping[str, str]] = _TABLES["elsewhere"]
RULES: Final[Mapping[str, list[str]]] = _TABLES["rules"]
EPILOG: Final[str] = _TABLES["epilog"]
