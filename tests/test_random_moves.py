"""Random straight moves end at their goals, near singularities, too."""

import pytest
from random_moves import run_moves

NEAR_SINGULARITIES = (2, 8, 13, 22)  # moves whose goals once were missed by 1.5 to 2.5 mm


def test_random_moves_end_at_their_goals_within_the_limits():
    moves = run_moves(24, only=(1, *NEAR_SINGULARITIES[:2]))
    assert all(move.ok for move in moves)
    assert moves[0].rms <= 5e-5  # m


@pytest.mark.long
def test_moves_with_the_time_they_need_keep_the_torque_rate_too():
    before, after = (run_moves(11, only=(11,), timing_share=share)[0] for share in (None, 0.95))
    assert before.ok
    assert before.torque_rate > 1.0
    assert after.keeps_all
    assert 1.0 < after.slower < 2.0


def test_joints_that_near_their_ends_hand_over_gradually():
    """Its joint 7 once braked hard before its end, and the torque rate was 10 times its limit."""
    (move,) = run_moves(76, only=(76,))
    assert move.ok
    assert move.torque_rate <= 5.0
    assert move.rms <= 5e-5  # m


@pytest.mark.long
def test_a_joint_at_its_end_is_refused():
    (move,) = run_moves(55, only=(55,), timing_share=0.95)
    at_limits = [joint for joint, kind in enumerate(move.limit, 1) if kind]
    assert any(f"row 2: joint {n} reaches the end of its range" in move.refused for n in at_limits)
    assert not move.keeps_all


# The comparison with mink runs, and shows what each side is good at.
