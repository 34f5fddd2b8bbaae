"""The native plant and the plant in Python accept, and refuse, the same starts of the block."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import fmu_jobs
import pytest
from fmu_support import Worker
from hypothesis import given, settings
from hypothesis import strategies as st
from panda_cosim.assets import SCENES
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.plant.parameters import YAW_RANGE

pytestmark = pytest.mark.fmu
EDGES = (0.45, 0.85, 0.1, 0.5, 0.0, -1.0, 1.0)  # [m] of the table, of the base, of the floor


@pytest.fixture(scope="module", params=(2, 3), ids=("fmi2", "fmi3"))
def plant(request: pytest.FixtureRequest) -> str:
    return str(build(("plant",), target=Target(fmi=request.param))["plant"])


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    made = Worker(tmp_path_factory.mktemp("worker"))
    yield made
    made.close()


def places() -> Any:
    """Coordinates: anywhere, on an edge, and a hair beside one."""
    edge = st.sampled_from(EDGES)
    beside = st.builds(lambda x, d: x + d, edge, st.floats(-0.06, 0.06))
    hair = st.builds(lambda x, d: x + d, edge, st.sampled_from([-1e-12, 1e-12, -1e-16, 1e-16]))
    return (st.floats(-1.0, 1.0) | edge | beside | hair).filter(lambda x: -1.0 <= x <= 1.0)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(SCENES), places(), places(), st.floats(*YAW_RANGE))
def test_both_plants_agree_on_where_the_block_can_start(
    plant: str, worker: Worker, scene: str, x: float, y: float, yaw: float
) -> None:
    native, python = worker.do(fmu_jobs.block_starts, plant, scene, x, y, yaw)
    assert native == python


@pytest.mark.parametrize(
    ("place", "height", "inside"),
    [((0.4, -0.2), 0.05, ""), ((0.6, 0.35), 0.25, ""), ((0.0, 0.0), None, "inside 'link0'"),
     ((0.44, 0.3), None, "inside 'table'")],
)  # fmt: skip
def test_the_block_stands_on_floor_or_table_alone(
    plant: str, worker: Worker, place: tuple[float, float], height: float | None, inside: str
) -> None:
    native, python = worker.do(fmu_jobs.block_starts, plant, SCENES[0], *place, 0.0)
    assert native == python
    if height is None:
        assert inside in native
    else:
        assert native[:3] == [*place, height]
