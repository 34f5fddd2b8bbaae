"""Laws that give torques, or angles: the words for what does not fit, and options in any order."""

from __future__ import annotations

import pytest

from forked import command

LAWS = '''
import numpy as np
from clipped import clipped

HOME = np.array([0, 0, 0, -1.57079, 0, 1.57079, -0.7853])

class OSC:
    """Operational space: torques; they settle soon, so that an analysis is short."""
    stiffness = 400.0
    def update(self, time, pos_cmd, hand_xpos, jac, qpos, qvel, qfrc_bias, grip_cmd):
        force = self.stiffness * (pos_cmd - hand_xpos) - 40 * (jac[:3] @ qvel)
        torque = jac[:3].T @ force + 200 * (HOME - qpos) - 30 * qvel + qfrc_bias
        return np.hstack((clipped(torque), 255 * grip_cmd / 0.08))

class Angles:
    """Resolved rate: servo targets."""
    def update(self, time, pos_cmd, hand_xpos, jac, qpos, grip_cmd):
        move = np.linalg.pinv(jac[:3]) @ (pos_cmd - hand_xpos)
        return np.hstack((qpos + 0.1 * move, 255 * grip_cmd / 0.08))
'''
LATE = '''
import numpy as np

class Late:
    """Imports a module beside it too late."""
    def update(self, time, qpos, qfrc_bias):
        from clipped import clipped
        return np.hstack((clipped(qfrc_bias), 0.0))
'''
MOTORS = ("--set", "scene=motors")


@pytest.fixture
def laws(tmp_path):
    (tmp_path / "laws.py").write_text(LAWS)
    (tmp_path / "late.py").write_text(LATE)
    (tmp_path / "clipped.py").write_text(
        "import numpy as np\ndef clipped(torque): return np.clip(torque, -80, 80)\n"
    )
    (tmp_path / "hold").mkdir()
    (tmp_path / "hold" / "scenario.toml").write_text("duration = 0.2\n")
    (tmp_path / "hold" / "trajectory.csv").write_text(
        "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n0.2,home,0,0,0,0.08\n"
    )
    return tmp_path


def said(*arguments: object) -> tuple[int, str]:
    done = command(*arguments)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("law_first", [True, False])
def test_a_torque_law_and_its_scene_are_named_in_any_order(laws, law_first):
    law = ("--controller", f"{laws / 'laws.py'}:OSC")
    options = (*law, *MOTORS) if law_first else (*MOTORS, *law)
    gain = ("--set", "controller.stiffness=300")
    code, text = said("run", laws / "hold", *options, *gain, "--no-video", "--no-view",
                      "--out", laws / "run")  # fmt: skip
    assert code == 0, text
    assert "controller.kp" not in text
    assert said("check", laws / "hold", *options, *gain)[0] == 0
    if not law_first:
        return  # an analysis parses its options by the same code
    code, text = said("analyze", laws / "hold", *options, *gain, "--at", "0.1", "--out", laws / "a")
    assert code == 0, text
    assert "plant.torque[7]" in text
    assert "plant.ctrl[8]" not in text  # the gripper has no loop
    assert "gauss-seidel: stable" in text


@pytest.mark.parametrize(
    ("law", "scene", "fits"),
    [("OSC", (), 'scene "motors" takes torques'), ("Angles", MOTORS, 'scene "tabletop" takes')],
)
def test_a_law_that_does_not_fit_the_scene_is_refused_with_the_one_that_does(
    laws, law, scene, fits
):
    options = ("--controller", f"{laws / 'laws.py'}:{law}", *scene)
    code, text = said("run", laws / "hold", *options, "--no-video", "--out", laws / "run")
    assert code == 1
    assert fits in text
    code, text = said("analyze", laws / "hold", *options, "--out", laws / "analysis")
    assert code == 1
    assert fits in text
    assert not (laws / "analysis").exists()


def test_a_module_that_is_imported_in_a_method_is_named(laws):
    for name in ("run", "check"):
        code, text = said(name, laws / "hold", "--controller", f"{laws / 'late.py'}:Late", *MOTORS)
        assert code == 2, text
        assert "late.py, line 6: update imports clipped; must import it at the top" in text
    assert not (laws / "runs").exists()


@pytest.mark.parametrize(
    ("head", "body", "code", "words"),
    [
        ("import no_such", "return [0.0] * 8", 2, "bad.py, line 1: ModuleNotFoundError"),
        ("", "return 'text'", 1, "bad.py: update returned 'text'; must be numbers"),
    ],
)
def test_a_law_that_cannot_be_imported_or_returns_no_numbers_is_named(
    laws, head, body, code, words
):
    (laws / "bad.py").write_text(
        f"{head}\nclass Bad:\n    def update(self, time, qpos):\n        {body}\n"
    )
    law = ("--controller", f"{laws / 'bad.py'}:Bad")
    done = said("run", laws / "hold", *law, "--no-video", "--out", laws / "run")
    assert done[0] == code
    assert words in done[1]
    assert (laws / "run").exists() == (code == 1)
