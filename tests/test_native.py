"""The FMI layer of native FMUs, in FMI 2.0 and FMI 3.0."""

from __future__ import annotations

from pathlib import Path

import native_probe
import pytest
from fmu_support import Worker, compiler
from native_support import unpacked
from panda_cosim.fmus.build.libraries import compile_library

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]
NAMES = [check.__name__ for check in native_probe.CHECKS]


@pytest.fixture(scope="module")
def library() -> bytes:
    return compile_library(native_probe.SOURCE)


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("name", NAMES)
def test_(worker: Worker, library: bytes, tmp_path: Path, name: str, version: int) -> None:
    folder = unpacked(tmp_path / "fmu", "probe", native_probe.TABLE, {}, library=library)
    worker.do(native_probe.run, name, str(folder), version)


def test_the_same_sources_give_the_same_bytes(library: bytes) -> None:
    assert compile_library(native_probe.SOURCE) == library
