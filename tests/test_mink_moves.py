"""The comparison with mink runs, and shows what each side is good at."""

import pytest
from mink_moves import MinkController, described
from random_moves import HOME, random_goals, run_move

from panda_cosim.controller.gains import Gains


@pytest.mark.long
def test_both_follow_a_plain_move_and_the_table_counts():
    goal = next(random_goals(1))
    ours, theirs = (
        run_move(1, HOME, goal, Gains()),
        run_move(1, HOME, goal, Gains(), MinkController),
    )
    assert ours.ok
    assert theirs.ok
    assert min(ours.update_us, theirs.update_us) > 1.0
    assert described("both", [ours, theirs]).startswith("| both | 2 | 0 | ")
