"""Commands replace only files that they made, and nothing that is a recording."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from forked import command
from panda_cosim.fmus.atomic import MARK, check_replaceable
from panda_cosim.fmus.build.ssp import STRUCTURE_FILE, WrittenSystem, structure_description
from panda_cosim.fmus.errors import InputError
from panda_cosim.study.compare.junit import write_cases
from panda_cosim.task.files import marked_json
from regress_support import columns, record

SLAVE = Path(__file__).parent / "slaves" / "decay.py"
PAGES = Path(__file__).parent.parent / "src" / "panda_cosim"
MODEL = '<mujoco><worldbody><body><joint/><geom size=".1" mass="1"/></body></worldbody></mujoco>'


def written_by_commands(folder: Path) -> dict[str, tuple[tuple[object, ...], Path]]:
    """Return command lines with a file that each of them would write."""
    run, out = folder / "run", folder / "out"
    return {
        "view beside the run": (("view", run), run / "view.html"),
        "plot": (("plot", run, "--out", out / "a.png"), out / "a.png"),
        "video": (("render", run, "--out", out), out / "video.mp4"),
        "compare": (("compare", run, run, "--out", out), out / "compare.html"),
        "export": (("export", run, out / "a.csv"), out / "a.csv"),
        "inputs": (("inputs", "push", out / "a.csv"), out / "a.csv"),
        "analyze": (("analyze", "--out", out), out / "loops.png"),
        "bench": (("bench", "--json", out / "a.json"), out / "a.json"),
        "report": (("regress", "push", "--report", out), out / "report.html"),
        "junit": (("regress", "push", "--report", out), out / "junit.xml"),
        "junit of a run": (("run", "push", "--junit", out / "a", "--out", folder / "b"), out / "a"),
        "sweep report": (("sweep", "report", folder, "--out", out / "a"), out / "a"),
        "model": (("mjcf2fmu", folder / "m.xml", "--out", out / "m.fmu"), out / "m.fmu"),
        "slave": (("build", "--slave", SLAVE, "--out", out), out / "Decay.fmu"),
        "system": (("build", "--out", out), out / "Panda.ssp"),
        "retime": (("retime", "push", "--out", out), out / "trajectory.csv"),
        "new": (("new", out), out / "trajectory.csv"),
    }


@pytest.mark.parametrize("case", written_by_commands(Path()))
def test_a_file_that_no_command_made_stays(tmp_path, case):
    record(tmp_path / "run", columns(2))
    (tmp_path / "m.xml").write_text(MODEL)
    arguments, file = written_by_commands(tmp_path)[case]
    file.parent.mkdir(exist_ok=True)
    file.write_text("<!DOCTYPE html>\nmine, about panda-cosim")
    before = sorted(tmp_path.rglob("*"))
    done = command(*arguments, cwd=tmp_path, code=2)
    error = done.stderr.splitlines()[-1]
    assert f"{file}: already exists; must be " in error
    assert file.read_text() == "<!DOCTYPE html>\nmine, about panda-cosim"
    assert sorted(tmp_path.rglob("*")) == before


def test_what_was_made_is_replaced_and_so_is_a_file_that_is_given_up(tmp_path):
    run, out = tmp_path / "run", tmp_path / "out"
    record(run, columns())
    for _ in range(2):
        command("plot", run, "--out", out / "x.png", cwd=tmp_path, code=0)
    assert [path.name for path in out.iterdir()] == ["x.png"]
    (out / "x.png").write_text("mine")
    command("plot", run, "--out", out / "x.png", "--overwrite", cwd=tmp_path, code=0)
    assert (out / "x.png").read_bytes().startswith(b"\x89PNG")


def test_no_picture_or_page_takes_the_place_of_a_recording(tmp_path):
    content = record(tmp_path, columns()).path.read_bytes()
    for name in ("view", "plot"):
        place = tmp_path / f"{name}.png"  # a name that plot takes for a file's
        place.write_bytes(content)
        done = command(name, tmp_path, "--out", place, "--overwrite", cwd=tmp_path, code=2)
        assert "holds a recording; must be another file" in done.stderr
        assert place.read_bytes() == content


def test_every_page_carries_the_mark():
    pages = [path for path in PAGES.rglob("*.html") if "<!DOCTYPE" in path.read_text()]
    assert pages
    for page in pages:
        assert f"<!-- {MARK} -->" in page.read_text(), page


def test_texts_and_archives_that_were_made_here_are_known(tmp_path):
    paths = {name: tmp_path / name for name in ("a.json", "a.xml", "a.ssp", "b.ssp", "c.ssp")}
    paths["a.json"].write_text(marked_json(json.dumps({"kp": 8})))
    write_cases("panda-cosim run", [], paths["a.xml"])
    system = structure_description(WrittenSystem({}, (), 1.0))
    others = {"b.ssp": system.replace(b"panda-cosim", b"another"), "c.ssp": MARK.encode()}
    for name, description in {"a.ssp": system, **others}.items():
        with zipfile.ZipFile(paths[name], "w") as archive:
            archive.writestr(STRUCTURE_FILE, description)
    check_replaceable(paths["a.json"], paths["a.xml"], paths["a.ssp"])
    for name in others:
        with pytest.raises(InputError, match="already exists"):
            check_replaceable(paths[name], overwrite=False)
    broken = paths["a.ssp"].read_bytes()[:-30]
    paths["a.ssp"].write_bytes(broken)
    with pytest.raises(InputError, match="already exists"):
        check_replaceable(paths["a.ssp"])
