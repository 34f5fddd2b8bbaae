"""A law is given as a class, from a file, a script or a notebook, with the data beside it."""

import json
import sys
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from bounded import ran
from panda_cosim import load_scenario
from panda_cosim.fmus.sources.law import law_code
from panda_cosim.fmus.sources.written_class import file_of
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.scene import load_scene
from refusals import refused

PARTS = '''
import json
from math import sin
from pathlib import Path

import numpy as np

from panda_cosim import run_scenario

BENT, GAIN = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]), 2.0


def bend(angles):
    return again(angles) if GAIN < 0.0 else angles + GAIN * sin(1.0) * BENT


def again(angles):  # a circle
    return bend(angles)


class Base:
    def bent(self, angles):
        return bend(angles)
''', '''
class MyLaw(Base):
    """Holds the arm where it starts, bent."""

    share = 0.01

    def update(self, time, qpos):
        self.first = getattr(self, "first", qpos[:7])
        return np.append(self.first + self.share * (self.bent(self.first) - self.first), 255.0)
''', '''
run = run_scenario("tutorial", OUT, values={"duration": 0.02}, controller=MyLaw)
Path(OUT, "ctrl.json").write_text(json.dumps(run.recording["controller.ctrl"].tolist()))
'''  # fmt: skip
HANDLE = object()
NOTEBOOK = """
import sys
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
for cell in sys.argv[1:]:
    assert shell.run_cell(cell).success
"""


def written(folder: Path, *parts: str) -> Path:
    """Write the script, whose run goes to a folder `run` beside it."""
    script = folder / "script.py"
    script.write_text(f"OUT = {str(folder / 'run')!r}\n" + "".join(parts))
    return script


@pytest.mark.parametrize("where", ["script", "notebook"])
def test_a_class_of_a_script_or_notebook_runs_and_the_run_can_be_repeated(tmp_path, where):
    script = written(tmp_path, *PARTS)
    cells = [f"OUT = {str(tmp_path / 'run')!r}", *PARTS]
    arguments = [str(script)] if where == "script" else ["-c", NOTEBOOK, *cells]
    done = ran([sys.executable, *arguments])  # the script is unguarded: it must not run again
    assert done.returncode == 0, done.stderr
    ctrl = np.array(json.loads((tmp_path / "run" / "ctrl.json").read_text()))
    bent = 0.01 * 2.0 * np.sin(1.0) * np.arange(0.1, 0.75, 0.1)
    home = load_scene(PlantParameters(scene="tutorial")).key("home").qpos[:7]
    assert ctrl[-1, :7] - home == pytest.approx(bent, abs=1e-3)  # rad
    kept = load_scenario(tmp_path / "run" / "scenario")
    assert kept.fmus == {"controller": "MyLaw.py:MyLaw"}


def test_a_class_of_a_file_is_used_in_its_file(tmp_path, monkeypatch):
    (tmp_path / "laws_of_mine.py").write_text("class Law:\n    def update(self, time, qpos): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    import laws_of_mine  # type: ignore[import-not-found]  # noqa: PLC0415 - it has just been made

    assert file_of(laws_of_mine.Law) == f"{tmp_path / 'laws_of_mine.py'}:Law"
    changed = load_scenario("push").changed({"fmus.controller": laws_of_mine.Law})
    assert changed.fmus["controller"] == f"{(tmp_path / 'laws_of_mine.py').resolve()}:Law"


@pytest.mark.parametrize("value", [object(), Decimal(1), [Decimal(1)], lambda: 1])
def test_what_a_class_uses_and_cannot_be_written_is_named(monkeypatch, value):
    class Law:
        def update(self, time, qpos):
            return HANDLE, qpos

    monkeypatch.setitem(globals(), "HANDLE", value)
    kind = type(value).__name__
    said = refused(file_of, Law)
    assert f"uses HANDLE of type {kind}; must be a number" in said or "source of <lambda>" in said
    said = refused(load_scenario("push").changed, {"fmus.controller": int})
    assert said == "fmus.controller: the source of int is not known; must be in a file"


def test_files_that_a_law_names_are_packed_and_no_others(tmp_path):
    for name in ("gains.csv", "data/table.npz", "secret.txt", "../outside.csv"):
        (tmp_path / "laws" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "laws" / name).write_text("1 2 3")
    law = tmp_path / "laws" / "law.py"
    law.write_text(
        "import helper\nA, B, C = 'gains.csv', '../outside.csv', 'missing.csv'\n"
        f"D = '/etc/hostname' + {'x' * 5000!r} + '\\0'\n"
    )
    law.with_name("helper.py").write_text("TABLE = 'data/table.npz'\n")
    assert law_code(law).keys() == {"law.py", "helper.py", "gains.csv", "data/table.npz"}
