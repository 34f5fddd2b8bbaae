"""Rows of a table that end early: when, what follows, and in all ways that a table is played."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from forked import QUIET, command
from panda_cosim import InputError, Recording, Scenario, Session, run_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.cli.outcome import outcome_lines
from panda_cosim.fmus.interface.controller import COMMANDS, POSTURE_COMMANDS
from panda_cosim.run.prepare import prepare
from panda_cosim.task.input_table import InputTable
from panda_cosim.task.rotations import Array
from panda_cosim.task.scenario import Push
from panda_cosim.task.table import TableRow, TrajectoryTable
from random_tasks import run_in_memory

BEGIN, DOWN, REST, END = 1.0, 2.0, 2.3, 3.0  # s
DEPTH, ABOVE = 0.305, 0.325  # m; closed fingers touch the table at 0.312
BRAKING = 0.02  # s
LEAST_GAP = 1e-12


def rows(until: str, *, down: float = DOWN) -> TrajectoryTable:
    """The hand goes down to the table, rests there, and goes elsewhere."""
    places = ((BEGIN, 0.6, ABOVE), (down, 0.6, DEPTH), (down + REST - DOWN, 0.6, DEPTH),
              (down + END - DOWN, 0.5, 0.45))  # fmt: skip
    return TrajectoryTable((
        TableRow(time=0.0, frame="home", position=(0.0, 0.0, 0.0), grip=0.0),
        *(TableRow(time=time, frame="world", position=(x, 0.35, z), grip=0.0,
                   until=until if row == 1 else "")
          for row, (time, x, z) in enumerate(places)),
    ))  # fmt: skip


def scenario(until: str, **changes: float) -> Scenario:
    return Scenario(name="guarded", table=rows(until, **changes), duration=3.2)


def felt(run: dict[str, Array]) -> Array:
    """Force along the way down [N] that explains the servos' torques best, at each row."""
    lever = -run["plant.jac"].reshape(-1, 6, 7)[:, 2]
    torque = run["plant.actuator_force"][:, :7] - run["plant.qfrc_bias"]
    return np.einsum("ij,ij->i", lever, torque) / np.einsum("ij,ij->i", lever, lever)


def first_contact(run: dict[str, Array], bound: float) -> int:
    """The first row at which the mean of ten is that much above the mean of a hundred."""
    force, began = felt(run), round(1e3 * BEGIN) + 1
    base = force[began + 60 : began + 160].mean()
    above = (row for row in range(began + 160, round(1e3 * DOWN))
             if force[row - 9 : row + 1].mean() - base > bound)  # fmt: skip
    return next(above)


def check_course(run: dict[str, Array], at: int) -> None:
    """Check the commands after a row has ended, from the quintic alone."""
    command, speed = run["controller.pos_cmd"], run["controller.vel_cmd"]
    u = (at * 1e-3 - BEGIN) / (DOWN - BEGIN)
    ended = ABOVE + (DEPTH - ABOVE) * (10 * u**3 - 15 * u**4 + 6 * u**5)
    down = (DEPTH - ABOVE) * 30 * (u * (1 - u)) ** 2 / (DOWN - BEGIN)  # [m/s]
    there = np.array([0.6, 0.35, ended + down * BRAKING / 2])
    rest = round(1e3 * (REST - DOWN))
    for tick in range(21):
        left = 1.0 - tick * 1e-3 / BRAKING
        assert speed[at + tick, 2] == pytest.approx(down * (3 * left**2 - 2 * left**3), abs=1e-12)
    between = (speed[at : at + 20, 2] + speed[at + 1 : at + 21, 2]) / 2 * 1e-3
    assert np.abs(command[at + 1 : at + 21, 2] - ended - np.cumsum(between)).max() < 1e-6
    assert np.abs(command[at + 20 : at + rest] - there).max() < LEAST_GAP
    assert not speed[at + 20 : at + rest].any()
    way, took = np.array([0.5, 0.35, 0.45]) - there, END - REST
    for tick in range(0, round(1e3 * took), 50):
        u = tick * 1e-3 / took
        s, rate = 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * (u * (1 - u)) ** 2 / took
        np.testing.assert_allclose(command[at + rest + tick], there + s * way, atol=1e-9)
        np.testing.assert_allclose(speed[at + rest + tick], rate * way, atol=1e-9)
    assert (command[at + rest + round(1e3 * took) :] == command[-1]).all()


def test_a_row_ends_at_the_first_contact_and_later_rows_move_forward():
    run = run_in_memory(scenario("contact > 3"))
    at = first_contact(run.signals, 3.0)
    (end,) = run.summary.row_ends
    assert end == {"row": 3, "until": "contact > 3", "ended_s": pytest.approx(at * 1e-3)}
    check_course(run.signals, at)
    assert run.signals["plant.unwanted_contact_force"].max() < 40.0  # N


@pytest.mark.parametrize("until", ["external_force > 6", "external_force[3] > 6"])
def test_a_row_ends_by_the_observed_force(until):
    run = run_in_memory(scenario(until))
    force = run.signals["controller.external_force"]  # of the tick before
    size = np.abs(force[:, 2]) if "[3]" in until else np.linalg.norm(force[:, :3], axis=1)
    at = 1001 + int(np.argmax(size[1000:] > 6.0))
    assert run.summary.row_ends[0]["ended_s"] == pytest.approx(at * 1e-3)
    check_course(run.signals, at)


def pushing(table: TrajectoryTable) -> InputTable:
    """A force on a link, 0 up to the row that ends early, then up to 1 N at the last row."""
    cells = ("0", "0", "0", "0.3", "1")
    return InputTable(tuple(row.time for row in table.rows), {"plant.link4_force[1]": cells})


def test_inputs_in_the_table_move_forward_with_its_rows_and_those_of_other_times_do_not():
    task = scenario("contact > 3")
    within = pushing(task.table)
    beside = replace(within, times=tuple(time + 0.1 for time in within.times))
    for inputs, moves in ((within, True), (beside, False)):
        run = run_in_memory(replace(task, input_table=inputs))
        at = round(1e3 * run.summary.row_ends[0]["ended_s"])
        tick = np.arange(len(run.signals["time"]))
        ahead = np.where((tick >= at) & moves, round(1e3 * DOWN) - at, 0)
        force = np.interp(1e-3 * (tick + ahead), inputs.times, [0.0, 0.0, 0.0, 0.3, 1.0])
        np.testing.assert_allclose(run.signals["plant.link4_force"][:, 0], force, atol=1e-12)


def test_a_row_that_never_ends_early_is_said_and_changes_nothing():
    guarded = run_in_memory(scenario("contact > 500"))
    plain = run_in_memory(scenario(""))
    assert guarded.summary.row_ends[0]["ended_s"] is None
    assert plain.summary.row_ends == ()
    for name, values in plain.signals.items():
        assert np.array_equal(values, guarded.signals[name]), name
    lines = outcome_lines(guarded.summary, guarded, realtime=False)
    told = [text for text, _ in islice(lines, 3)]
    assert "Row 3 (contact > 500) never ended early" in told


def test_a_session_and_its_replay_end_the_row_at_the_same_tick(tmp_path):
    run = run_scenario(scenario("contact > 3"), tmp_path / "run")
    with Session(scenario("contact > 3"), tmp_path / "session") as session:
        for size in (700, 1, 499, 300, 1, 800):
            session.step(size)
        session.move_waypoint(4, frame="world", position=(0.5, 0.35, 0.45))
        session.finish()
    again = tmp_path / "again"
    assert command("replay", tmp_path / "session", "--out", again, *QUIET).returncode == 0
    for folder in (tmp_path / "session", again):
        other = Recording.open(folder)
        assert other.metadata["row_ends"] == run.recording.metadata["row_ends"]
        assert other.metadata["row_times"] == run.recording.metadata["row_times"]
        for name in run.recording.columns:
            assert np.array_equal(run.recording[name], other[name]), name


@pytest.mark.parametrize(
    "until", ["contact > 3", pytest.param("external_force > 6", marks=pytest.mark.long)]
)
def test_the_player_in_an_ssp_gives_the_same_commands(tmp_path, until):
    push = Push(start=2.8, duration=0.1, force=(0.0, 3.0, 0.0))  # is played, too
    table = TrajectoryTable(tuple(replace(r, posture=HOME_Q) for r in rows(until).rows))
    task = replace(scenario(until), table=table, push=(push,), input_table=pushing(table))
    run = run_scenario(task, tmp_path / "run")
    kept = tmp_path / "run" / "scenario"
    assert command("build", "--scenario", kept, "--out", tmp_path / "ssp").returncode == 0
    command("run", tmp_path / "ssp" / "Panda.ssp", *QUIET, "--out", tmp_path / "again", code=0)
    again = Recording.open(tmp_path / "again")
    assert run.recording.metadata["row_ends"][0]["ended_s"] is not None
    played = [f"controller.{name}" for name in (*COMMANDS, *POSTURE_COMMANDS)]
    # The push is at its time, although rows have moved forward.
    for name in (*played, "plant.push_force", "plant.link4_force[1]"):
        other = again[f"trajectory.{name.partition('.')[2]}"]
        assert np.array_equal(run.recording[name], other), name


def test_rows_that_cannot_end_early_are_refused():
    for until in ("touch > 3", "contact > -3", "external_force[7] > 1"):
        with pytest.raises(InputError, match="must be blank, or as contact > 3"):
            rows(until)
    good = scenario("contact > 3")
    for other in ({"interpolation": "spline"}, {"timing": "optimal"}):
        with pytest.raises(InputError, match="until: is in the table"):
            replace(good, **other)
    with pytest.raises(InputError, match=r"row 3, column until: contact is known 160 ms after"):
        prepare(scenario("contact > 3", down=1.15))
    first = replace(good.table.rows[0], until="contact > 3")
    table = TrajectoryTable((first, *good.table.rows[1:]))
    with pytest.raises(InputError, match="row 1, column until: the hand must move"):
        prepare(replace(good, table=table))
