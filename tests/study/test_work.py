"""Work that is given to processes: what ends or hangs costs its own call."""

import os
from pathlib import Path

import pytest

import work_jobs
from bounded import is_alive, wait_until
from panda_cosim.study.work import Workers


def same(reason: str) -> str:
    return reason


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))


def test_a_process_works_again_and_is_apart_from_its_caller(capfd):
    with Workers(1) as workers:
        answers = [
            workers.submit(work_jobs.told, n, died=same, late=same).result() for n in range(3)
        ]
    assert [answer[0] for answer in answers] == [0, 1, 2]
    (process,) = {answer[1] for answer in answers}
    assert process != os.getpid()
    assert {answer[2:] for answer in answers} == {(process, False)}
    printed = capfd.readouterr()
    assert printed.out == ""  # which is the command's result
    assert printed.err.count("printed") == 3
    assert not is_alive(process)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("signal", "its process ended with signal 11"),
        ("exit", "its process ended with exit code 0"),
        ("exit in C", "its process ended with exit code 0"),
        ("exception", "its process ended with exit code 1"),
    ],
)
def test_a_call_that_ends_its_process_costs_itself_alone(how, reason):
    with Workers(2) as workers:
        lost = workers.submit(work_jobs.end, how, died=same, late=str.upper)
        others = [workers.submit(work_jobs.told, n, died=same, late=same) for n in range(4)]
        assert lost.result(60.0) == reason
        assert [other.result(60.0)[0] for other in others] == [0, 1, 2, 3]


def test_a_call_whose_process_was_killed_is_tried_again(tmp_path):
    with Workers(1, attempts=2) as workers:
        again = workers.submit(work_jobs.end_once, tmp_path / "mark", died=same, late=same)
        lost = workers.submit(work_jobs.end, "signal", died=same, late=same)
        assert again.result(60.0) == "done"
        assert lost.result(60.0) == "its process ended with signal 11"


def test_a_call_beyond_its_time_is_killed(tmp_path):
    mark = tmp_path / "mark"
    with Workers(1) as workers:
        late = workers.submit(work_jobs.sleep, mark, died=str.upper, late=same, time_limit=0.5)
        assert late.result(60.0) == "took more than 0.5 s and was killed"
        assert not is_alive(int(mark.read_text()))
        assert workers.submit(work_jobs.told, 1, died=same, late=same).result(60.0)[0] == 1


def test_the_end_kills_what_runs_and_starts_nothing_more(tmp_path):
    with Workers(1) as workers:
        workers.submit(work_jobs.sleep, tmp_path / "first", died=same, late=same)
        second = workers.submit(work_jobs.sleep, tmp_path / "second", died=same, late=same)
        first = tmp_path / "first"
        wait_until(lambda: first.exists() and first.read_text())
    assert not is_alive(int(first.read_text()))
    assert second.done()
    assert not (tmp_path / "second").exists()
