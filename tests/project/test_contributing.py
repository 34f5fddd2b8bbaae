"""CONTRIBUTING.md says what is so: its example works, its paths exist."""

import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bounded import ran
from fault_support import write_files
from fmu_support import copy_libraries, needs_compiler
from panda_cosim import Recording
from panda_cosim.fmus.master.fmu_file import Fmu

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
SCENARIO = ("duration = 0.05\n", "0,home,0,0,0,0.08", "0.05,home,0,0,0.01,0.08")


def follow(diff: str, root: Path) -> None:
    """Insert each line that begins with + behind the line before it."""
    lines: list[str] = []
    file, at = root, 0
    for line in [*diff.splitlines(), "--- "]:
        if line.startswith("--- "):
            if lines:
                file.write_text("\n".join(lines) + "\n", encoding="utf-8")
            file = root / line[4:]
            lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
        elif line.startswith("+"):
            at += 1
            lines.insert(at, line[1:])
        else:
            (at,) = (i for i, known in enumerate(lines) if known == line[1:])


def copy_of_project(folder: Path) -> Path:
    """A copy of the project, and beside it a cache with what takes long to compile."""
    root = folder / "project"
    shutil.copytree(ROOT / ".ci", root / ".ci", symlinks=True)
    for each in ("assets", "plant", "controller", "fmus", "scenarios", "src", "tests"):
        ignored = shutil.ignore_patterns("node_modules", "*.egg-info")
        shutil.copytree(ROOT / each, root / each, ignore=ignored, symlinks=True)
    shutil.copy(ROOT / "pyproject.toml", root)
    copy_libraries(folder / "cache" / "libraries")
    return root


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """A copy of the project with the output of the example."""
    root = copy_of_project(tmp_path_factory.mktemp("changed"))
    (diff,) = re.findall(r"^```diff\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    follow(diff, root)
    return root


def python(changed: Path, *arguments: object, code: int = 0) -> str:
    """Run Python with the changed project and a cache of its own; return what it prints."""
    environment = os.environ | {
        "PYTHONPATH": str(changed / "src"),
        "PANDA_COSIM_CACHE": str(changed.parent / "cache"),
    }
    command = [sys.executable, "-P", *map(str, arguments)]
    done = ran(command, env=environment, code=code)
    return done.stderr + done.stdout


BUILD = """
import sys
from pathlib import Path
from panda_cosim import run_scenario
from panda_cosim.fmus.sources.model_fmu import model_part
from panda_cosim.fmus.sources.targets import build, build_fmu
if not Path(sys.argv[2]).exists():
    run_scenario(*sys.argv[1:3])
print(*build(["plant", "controller"]).values(), build_fmu(model_part(Path(sys.argv[3]))), sep="\\n")
"""
BALL = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"


@pytest.mark.long
def test_an_output_is_added_in_two_places_and_a_line_of_the_description_in_one(changed, tmp_path):
    write_files(tmp_path, *SCENARIO)
    model = tmp_path / "ball.xml"
    model.write_text(BALL)
    build = ("-c", BUILD, tmp_path, tmp_path / "run", model)
    before = [Fmu(Path(path)) for path in python(changed, *build).split()]
    recording = Recording.open(tmp_path / "run")
    passive, speeds = recording["plant.qfrc_passive"], recording["plant.qvel"][:, :7]
    assert passive.shape == (51, 7)
    assert recording.units["plant.qfrc_passive[7]"] == "N.m"
    # With no friction and no springs, passive forces are those of the joints' damping.
    moving = np.abs(speeds) > 1e-9
    assert np.all(passive[moving] * speeds[moving] < 0)
    assert before[0].variable("qfrc_passive[1]").variable.causality == "output"

    source = changed / "fmus" / "build" / "description.py"
    text = source.read_text(encoding="utf-8")
    source.write_text(text.replace('DATE: Final = "2026', 'DATE: Final = "2027'))
    after = [Fmu(Path(path)) for path in python(changed, *build).split()]
    dates = [fmu.description.generationDateAndTime[:4] for fmu in (*before, *after)]
    assert dates == ["2026"] * 3 + ["2027"] * 3


ACT = """
import json, sys
from pathlib import Path
import numpy as np
from panda_cosim import run_scenario
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.fmus.twins import notice
from panda_cosim.cli.commands.build import build_of
from panda_cosim.task.scenario import load_scenario
from panda_cosim.run.system.assembly import system_scenario
scenario, out, is_played = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] == "True"
runs = {"run": scenario}
if is_played:
    build_of(load_scenario(scenario), out, Target()).write(overwrite=False)
    runs["played"] = system_scenario(out / "Panda.ssp")
done = {name: run_scenario(each, out / name) for name, each in runs.items()}
print(json.dumps({
    "rows": {name: each.recording.sha256() for name, each in done.items()},
    "code": {name: each.summary.code for name, each in done.items()},
    "stepped_by": done["run"].summary.stepped_by,
    "moved": float(np.ptp(done["run"].recording["plant.hand_xpos"][:, 2])),
    "notes": [*done["run"].warnings, notice(["trajectory"])],
}))
"""
# What is edited; what of the run, or of what `build` wrote, is Python then.
EDITS = {
    "controller/pid.py": ("self._kp * error", "2.0 * self._kp * error", "controller"),
    "controller/ik.py": ("= gains.ik_gain * error", "= 2.0 * gains.ik_gain * error", "controller"),
    "controller/gains.py": ("bounded(50.0", "bounded(25.0", "controller"),
    "controller/reference_law.py": ("1.5 * twist_cmd", "1.4 * twist_cmd", "controller"),
    "plant/plant.py": ("data.xpos[self._hand]", "data.xpos[self._hand] + 0.001", "plant"),
    "fmus/inside/trajectory.py": ("self._tick += count", "self._tick += 2 * count", "trajectory"),
    "fmus/master/step.py": ("follower.get_outputs(row + 1)", "follower.get_outputs(row)", ""),
}


@pytest.mark.long
def test_a_changed_line_of_python_acts_and_is_named(tmp_path):
    root = copy_of_project(tmp_path)
    scenario = tmp_path / "scenario"
    write_files(scenario, *SCENARIO)

    def act(name: str, *, is_played: bool = True) -> Any:
        """Run the scenario and, if asked, what `build` makes of it."""
        told = python(root, "-c", ACT, scenario, tmp_path / "runs" / name, is_played)
        return json.loads(told.splitlines()[-1])

    for file in EDITS:  # a comment is no change
        with (root / file).open("a", encoding="utf-8") as source:
            source.write("\n# Nothing else.\n")
    before = act("before")
    assert before["code"]["run"] == {"controller": "native", "plant": "native"}
    assert before["stepped_by"] == "kernel"
    assert before["notes"] == [""]
    for file, (old, new, instance) in EDITS.items():
        text = (root / file).read_text(encoding="utf-8")
        assert text.count(old) == 1
        (root / file).write_text(text.replace(old, new), encoding="utf-8")
        where = "played" if instance == "trajectory" else "run"
        after = act(Path(file).stem, is_played=where == "played")
        assert after["rows"][where] != before["rows"][where], file
        assert after["moved"] > 0.0, "no value that was taken once"
        changed_code = {instance: "python"} if instance else {}
        assert after["code"][where] == before["code"][where] | changed_code
        assert after["stepped_by"] == ("kernel" if instance else "fmpy")
        note, *_ = (note for note in after["notes"] if note.startswith(f"{file}: changed"))
        assert "python .ci/stamp.py" in note
        (root / file).write_text(text, encoding="utf-8")
    broken = text.replace("leader.set_inputs(row)", "raise KeyError(row)", 1)  # of the step
    (root / file).write_text(broken, encoding="utf-8")
    told = python(root, "-m", "panda_cosim", "run", scenario, "--out", tmp_path / "broken", code=1)
    assert "unexpected KeyError: 0; " in told
    assert f"{file}: changed" in told


@needs_compiler
def test_a_stamp_is_only_renewed_if_c_and_python_are_equal(tmp_path):
    root = copy_of_project(tmp_path)
    stamp, law = root / "fmus" / "twins.json", root / "controller" / "pid.py"
    before = stamp.read_bytes()
    source, text = root / "fmus" / "native" / "controller_pid.c", law.read_text(encoding="utf-8")
    c = source.read_text(encoding="utf-8")
    assert c.count("gains->kp[i] * error[i]") == 1
    source.write_text(c.replace("gains->kp[i] * ", "1.5 * gains->kp[i] * "), encoding="utf-8")
    told = python(root, root / ".ci" / "stamp.py", "controller", code=1)
    assert "controller: C and Python differ" in told
    assert stamp.read_bytes() == before
    law.write_text(text + "# A comment is no change, and is not compared.\n", encoding="utf-8")
    python(root, root / ".ci" / "stamp.py")
    assert stamp.read_bytes() != before


def test_the_readme_of_fmus_names_files_that_exist_and_all_in_c():
    text = (ROOT / "fmus" / "README.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`([\w./*]+\.(?:py|c|h|toml|json))`", text))
    places = [ROOT / "fmus", *(ROOT / "fmus").iterdir(), ROOT]
    assert not [name for name in names if not any([*place.glob(name)] for place in places)]
    assert not [c for c in (ROOT / "fmus" / "native").glob("*.c") if not any(map(c.match, names))]


def test_every_path_exists():
    spans = re.findall(r"`([^`\n]+)`", TEXT)
    paths = {span for span in spans if re.fullmatch(r"\.?[a-z]\w*/[\w./]*", span)}
    paths -= {"src/panda_cosim/cli/commands/NAME.py"}
    assert paths
    assert not [path for path in paths if not (ROOT / path).exists()]
