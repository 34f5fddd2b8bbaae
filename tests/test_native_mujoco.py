"""The backend MuJoCo: the plant in Python is the reference, and `mj_step` for any other model."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import native_models
import pytest
from fmu_support import Worker, compiler

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]
NAMES = [check.__name__ for check in native_models.CHECKS]
SHIPPED = sorted(Path(mujoco.__file__).parent.glob("testdata/*.xml"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return native_models.build_plant(tmp_path_factory.mktemp("plant") / "fmu")


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("name", NAMES)
def test_(worker: Worker, folder: Path, name: str, version: int) -> None:
    worker.do(native_models.run, name, str(folder), version)


@pytest.mark.parametrize("path", [*native_models.MODELS, *SHIPPED], ids=lambda p: p.stem)
def test_any_model_steps_as_mj_step(worker: Worker, tmp_path: Path, path: Path) -> None:
    worker.do(native_models.a_model_steps_as_mj_step, str(tmp_path), str(path), 300)


@pytest.mark.skipif("MENAGERIE_ROOT" not in os.environ, reason="MENAGERIE_ROOT is not set")
def test_the_menageries_panda_steps_as_mj_step(worker: Worker, tmp_path: Path) -> None:
    path = Path(os.environ["MENAGERIE_ROOT"]) / "franka_emika_panda" / "scene.xml"
    worker.do(native_models.a_model_steps_as_mj_step, str(tmp_path), str(path), 300)
