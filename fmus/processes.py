"""The environment of all Python processes that the project starts."""

from typing import Final

# Of every Python that is started: what lies in the working directory is data, never code.
# `-P` does the same for that Python alone, this also for those that it starts.
SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}
