"""The backend that plays a table."""

from __future__ import annotations

from pathlib import Path

import native_player
import pytest
from fmu_support import Worker, compiler

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]
NAMES = [check.__name__ for check in native_player.CHECKS]


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("name", NAMES)
def test_(worker: Worker, tmp_path: Path, name: str, version: int) -> None:
    folder = native_player.build(tmp_path / "fmu")
    worker.do(native_player.run, name, str(folder), version)
