"""CONTRIBUTING.md says what is so: its example works, its paths exist."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmu_support import copy_libraries
from forked import command
from panda_cosim import Recording
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.scenarios.scenario.writer import make_scenario

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
QUIET = ("--no-video", "--no-view", "--no-plot")
SCENARIO = "duration = 0.05\n"
TABLE = "time,frame,x,y,z,grip\n0.0,home,0.0,0.0,0.0,0.08\n0.05,home,0.0,0.0,0.01,0.08\n"


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


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project with the output of the example."""
    root = tmp_path_factory.mktemp("changed") / "project"
    shutil.copytree(ROOT / ".ci", root / ".ci", symlinks=True)
    for folder in ("assets", "plant", "controller", "fmus", "scenarios"):
        ignored = shutil.ignore_patterns("node_modules")
        shutil.copytree(ROOT / folder, root / folder, ignore=ignored)
    copy_libraries(root.parent / "cache" / "libraries")
    (diff,) = re.findall(r"^```diff\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    follow(diff, root)
    return root


def python(changed: Path, *arguments: object) -> str:
    """Run Python with the changed project and a cache of its own; return what it prints."""
    environment = os.environ | {
        "PYTHONPATH": str(changed / ".ci" / "typing"),
        "PANDA_COSIM_CACHE": str(changed.parent / "cache"),
    }
    command = [sys.executable, "-P", *map(str, arguments)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


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


@pytest.mark.fmu
def test_an_output_of_the_plant_is_added_in_two_places_and_a_line_of_the_description_in_one(
    changed: Path, tmp_path: Path
) -> None:
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    (tmp_path / "trajectory.csv").write_text(TABLE)
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
    source.write_text(re.sub('"author": "[^"]*"', '"author": "Somebody else"', text))
    after = [Fmu(Path(path)) for path in python(changed, *build).split()]
    assert len(before) == len(after) == 3
    assert {fmu.description.author for fmu in before}.isdisjoint({"Somebody else"})
    assert {fmu.description.author for fmu in after} == {"Somebody else"}


def test_every_path_exists() -> None:
    spans = re.findall(r"`([^`\n]+)`", TEXT)
    paths = {span for span in spans if re.fullmatch(r"\.?[a-z]\w*/[\w./]*", span)}
    paths -= {"scenarios/cli/commands/NAME.py", ".ci/typing/panda_cosim/..."}
    assert paths
    assert not [path for path in paths if not (ROOT / path).exists()]


@pytest.mark.fmu
@pytest.mark.long
def test_a_changed_result_is_bisected(tmp_path: Path) -> None:
    """The commits of a repository change a law; the scenario and its reference stand outside."""
    repository, scenario = tmp_path / "repository", tmp_path / "push"
    make_scenario(repository / "law", ["law"])
    law, scenario = repository / "law" / "my_law.py", make_scenario(scenario)[0].parent
    part = '[fmus]\ncontroller = "../repository/law/my_law.py:ResolvedRate"\n'
    (scenario / "scenario.toml").write_text(SCENARIO + part)
    (scenario / "trajectory.csv").write_text(TABLE)
    recorded = command("regress", scenario, "--update")
    assert recorded.returncode == 0, recorded.stderr
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def shell(words: str) -> str:
        environment = os.environ | {"PATH": path}
        done = subprocess.run(words, shell=True, cwd=repository, capture_output=True, text=True,
                              env=environment, check=False, timeout=300)  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    shell("git init -q; git config user.name a; git config user.email a@b")
    first = law.read_text()
    for number, gain in enumerate(("10.0", "10.00", "5.0", "5.00")):
        law.write_text(first.replace("gain = 10.0", f"gain = {gain}"))
        shell(f"git add -A; git commit -qm 'commit {number}'")
    (script,) = re.findall(r"^git bisect run .*$", TEXT, re.MULTILINE)
    shell("git bisect start HEAD HEAD~3")
    assert "is the first bad commit" in shell(script)
    assert shell("git log -1 --format=%s refs/bisect/bad").strip() == "commit 2"
