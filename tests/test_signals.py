"""What the master carries from FMU to FMU: numbers in units of their own."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from fmu_support import compiler
from forked import command
from numpy.typing import NDArray
from panda_cosim import Recording
from toy_fmu import UNITS, toy_fmu

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="there is no C compiler"),
]
Array = NDArray[np.float64]
STEP, TICKS = 0.1, 20  # s
TIMES = STEP * np.arange(TICKS + 1)


def described(fmu: Path, *changes: tuple[str, str]) -> Path:
    """Change texts in an FMU's description."""
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = members["modelDescription.xml"].decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    members["modelDescription.xml"] = text.encode()
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return fmu


def measuring(fmu: Path, version: int, unit: str, base: str) -> Path:
    """A toy, y = u + t, whose inputs and outputs have a unit."""
    definition = f'<UnitDefinitions><Unit name="{unit}">{base}</Unit></UnitDefinitions>'
    changes = ((UNITS, definition), ('unit="N"', f'unit="{unit}"'))
    return described(toy_fmu(fmu, version), *changes)


def run(folder: Path, text: str, *arguments: str) -> Recording:
    (folder / "scenario.toml").write_text(f"duration = {STEP * TICKS}\nstep = {STEP}\n{text}")
    out = folder / "run"
    quiet = ("--no-video", "--no-view", "--no-plot")
    done = command("run", folder, "--out", out, *quiet, *arguments)
    assert done.returncode == 0, done.stderr
    return Recording.open(out)


DEGREE = '<BaseUnit rad="1" factor="0.017453292519943295"/>'
CELSIUS = '<BaseUnit K="1" offset="273.15"/>'
FAHRENHEIT = '<BaseUnit K="1" factor="0.5555555555555556" offset="255.37222222222223"/>'


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
@pytest.mark.parametrize(
    ("source", "target", "wanted"),
    [
        (("deg", DEGREE), ("rad", '<BaseUnit rad="1"/>'), np.radians),
        (("rad", '<BaseUnit rad="1"/>'), ("deg", DEGREE), np.degrees),
        (("mm", '<BaseUnit m="1" factor="1e-3"/>'), ("m", '<BaseUnit m="1"/>'), lambda y: y / 1000),
        (("degC", CELSIUS), ("K", '<BaseUnit K="1"/>'), lambda y: y + 273.15),
        (("degF", FAHRENHEIT), ("degC", CELSIUS), lambda y: (y - 32) / 1.8),
    ],
    ids=lambda side: side[0] if isinstance(side, tuple) else "",
)
def test_units_are_converted_as_both_sides_define_them(
    tmp_path: Path,
    source: tuple[str, str],
    target: tuple[str, str],
    wanted: Callable[[Array], Array],
    isolate: Sequence[str],
) -> None:
    measuring(tmp_path / "a.fmu", 2, *source)
    measuring(tmp_path / "b.fmu", 3, *target)
    recording = run(
        tmp_path,
        '[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"b.u[1,2]" = "a.y[2,1]"\n',
        *isolate,
    )
    given = TIMES[:-1] + STEP  # a's outputs after its step, in the row before
    np.testing.assert_array_equal(recording["a.y[2,1]"][:-1], given)
    np.testing.assert_allclose(recording["b.y[1,2]"][1:], wanted(given) + TIMES[1:], rtol=1e-14)
    assert recording.units["b.y[1,2]"] == target[0]


def test_units_without_a_conversion_are_refused_by_check_and_run(tmp_path: Path) -> None:
    measuring(tmp_path / "a.fmu", 2, "deg", DEGREE)
    measuring(tmp_path / "b.fmu", 2, "s", '<BaseUnit s="1"/>')
    (tmp_path / "scenario.toml").write_text(
        'duration = 1.0\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"b.u" = "a.y"\n'
    )
    for name in ("check", "run"):
        done = command(name, tmp_path, cwd=tmp_path)
        assert done.returncode == 2
        assert (
            "a.y (2x3) [deg] feeds b.u (2x3) [s]; must have the same unit"
            in done.stderr + done.stdout
        )
