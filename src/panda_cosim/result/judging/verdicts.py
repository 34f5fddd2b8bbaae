"""The table of all verdicts, verdicts.toml: words, colours, exit codes, kinds in JUnit."""

import tomllib
from pathlib import Path
from typing import Final

from .verdict import Verdict

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_ALL: Final = {name: Verdict(**row) for name, row in _TABLES.items()}
SUCCESS: Final = _ALL["success"]
FAILURE: Final = _ALL["failure"]
NO_CRITERIA: Final = _ALL["no_criteria"]
MISSED: Final = _ALL["missed"]
UNEXPECTED: Final = _ALL["unexpected"]
NOT_MEASURED: Final = _ALL["not_measured"]
ENDED: Final = _ALL["ended"]
TIMEOUT: Final = _ALL["timeout"]
STOPPED: Final = _ALL["stopped"]
FAILED: Final = _ALL["failed"]
INCOMPLETE: Final = (ENDED, TIMEOUT, STOPPED, FAILED)
VERDICTS: Final = tuple(_ALL.values())
