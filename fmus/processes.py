"""The environment of all Python processes that the project starts."""

from typing import Final

# For every Python process: files in the working directory are data and are never imported.
# `-P` does the same for that Python alone, this also for those that it starts.
SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}
