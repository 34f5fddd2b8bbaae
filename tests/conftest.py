"""What all tests share."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # so that tests find the modules beside them

from fmu_support import Worker

os.environ.pop("COLUMNS", None)  # xdist sets it, and tables in a pipe would be narrower than alone


@pytest.fixture(scope="session")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    """A process that runs FMUs."""
    working = Worker(tmp_path_factory.mktemp("worker"))
    yield working
    working.close()
