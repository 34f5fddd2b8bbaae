"""Without the package pythonfmu, what needs it says so in one line, and all else runs."""

from pathlib import Path

import pytest

from forked import script
from panda_cosim.task.writer import make_scenario

WITHOUT = """
import sys
from importlib import metadata
sys.modules["pythonfmu"] = None
def distribution(name):
    if name == "pythonfmu":
        raise metadata.PackageNotFoundError(name)
    return metadata.Distribution.from_name(name)
metadata.distribution = distribution
sys.argv[0] = "panda-cosim"
from panda_cosim.cli import main
main()
"""


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("run push --kind python --out OUT", 2),
        ("run push --kind pythonfmu --out OUT", 2),
        ("run sensor_offset --out OUT", 2),
        ("build --kind pythonfmu --out OUT", 2),
        ("build --slave SLAVE --out OUT", 2),
        ("regress push --kind python", 2),
        ("check sensor_offset", 2),
        ("check GUST", 2),
        ("run tutorial --duration 0.05 --no-video --no-view --out OUT", 3),
        ("check push", 0),
    ],
)
def test_without_the_package_only_what_needs_it_fails_in_one_line(words, code, tmp_path):
    places = {"OUT": tmp_path / "new", "SLAVE": Path(__file__).parent / "slaves" / "decay.py"}
    places["GUST"] = make_scenario(tmp_path / "gust", ["slave"])[0].parent
    done = script(WITHOUT, *(str(places.get(word, word)) for word in words.split()))
    assert done.returncode == code, done.stderr
    if code == 2:
        told = " ".join((done.stdout + done.stderr).split())
        assert told.count("the package pythonfmu is not installed") == 1
        assert "Traceback" not in told
        assert not (tmp_path / "new").exists()
