"""The state of a law's FMU restores every bit."""

from __future__ import annotations

from pathlib import Path

import law_state_jobs
import pytest
from fmu_support import Worker

pytestmark = pytest.mark.fmu


def test_a_laws_state_restores_every_bit(worker: Worker, tmp_path: Path) -> None:
    assert worker.do(law_state_jobs.restore, str(tmp_path))


@pytest.mark.parametrize(
    ("switch", "told"),
    [("lock", "self.thing holds a lock"), ("objects", "self.things holds a ndarray")],
)
def test_a_law_that_cannot_be_saved_says_which_attribute(
    worker: Worker, tmp_path: Path, switch: str, told: str
) -> None:
    text = worker.do(law_state_jobs.refuse, str(tmp_path), switch)
    assert f"{told}; must be numbers, texts" in text
