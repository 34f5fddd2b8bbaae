"""The digests of FMUs and sweeps change with everything that FMUs and rows depend on."""

import json
import os
import shutil
import sys
import tomllib
from pathlib import Path

import pytest

from bounded import ran
from panda_cosim.fmus.build import identity
from panda_cosim.study.sweep import store

ROOT = Path(__file__).parents[2]
# Says of each module what it imports, and by file which of the two digests change with it.
TOUCH = """
import grimp, json, sys
from pathlib import Path
from panda_cosim.fmus.build.identity import code_digest
from panda_cosim.study.sweep.store import ABOVE
def digests():
    code_digest.cache_clear()
    return code_digest(), code_digest(ABOVE)
root, before, changed = Path(sys.argv[1]), digests(), {}
for name in json.load(sys.stdin):
    content = (root / name).read_bytes()
    (root / name).write_bytes(content + b"#")
    changed[name] = [a != b for a, b in zip(before, digests())]
    (root / name).write_bytes(content)
graph = grimp.build_graph("panda_cosim", cache_dir=None, exclude_type_checking_imports=True)
print(json.dumps([changed, {n: [n, *graph.find_upstream_modules(n)] for n in graph.modules}]))
"""
Changed = dict[str, list[bool]]  # whether the digests of FMUs and sweeps change, by file


def layers(container: str) -> list[str]:
    """The layers within a package, from the top."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (found,) = (c["layers"] for c in settings["contracts"] if c.get("containers") == [container])
    return list(found)


def above(container: str, layer: str) -> set[str]:
    names = layers(container)
    return {name for each in names[: names.index(layer)] for name in each.split(" | ")}


def test_only_what_the_contracts_have_above_is_left_out():
    of_fmus = above("panda_cosim", "fmus") - {"__main__"}
    of_fmus |= {f"fmus/{name}" for name in above("panda_cosim.fmus", "sources")}
    assert set(identity.ABOVE) == of_fmus
    of_sweeps = above("panda_cosim", "study") - {"__main__"}
    of_sweeps |= {f"study/{name}" for name in above("panda_cosim.study", "sweep")}
    assert set(store.ABOVE) == of_sweeps
    assert not (ROOT / "scenarios" / "__init__.py").exists()  # so that it is no package


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What the digests change with, in a copy of the package, and what its modules import."""
    package = tmp_path_factory.mktemp("copy") / "panda_cosim"
    ignored = shutil.ignore_patterns("__pycache__", "node_modules", "*.parquet", "lib")
    shutil.copytree(ROOT / "src" / "panda_cosim", package, ignore=ignored)  # links as folders
    files = [p.relative_to(package).as_posix() for p in package.rglob("*") if p.is_file()]
    done = ran(
        [sys.executable, "-c", TOUCH, package],
        input=json.dumps(files),
        env=os.environ | {"PYTHONPATH": str(package.parent)},
    )
    changed, imported = json.loads(done.stdout)
    return changed, imported


@pytest.mark.parametrize(
    ("digest", "module"),
    [(0, "fmus.sources.targets"), (0, "fmus.inside.plant"), (0, "fmus.inside.controller"),
     (1, "study.sweep.row"), (1, "study.sweep.design"), (1, "controller.controller")],
)  # fmt: skip
def test_a_digest_changes_with_each_module_that_is_imported(found, digest, module):
    changed, imported = found
    for name in (needed := {*imported[f"panda_cosim.{module}"]} - {"panda_cosim"}):
        place = name.removeprefix("panda_cosim.").replace(".", "/")
        file = f"{place}.py" if f"{place}.py" in changed else f"{place}/__init__.py"
        assert changed[file][digest], file
    assert len(needed) > 5


def test_a_digest_changes_with_data_and_c_but_not_with_what_is_above(found):
    changed, _ = found
    for name in ("fmus/native/step.c", "fmus/native/instance.h", "assets/arm.xml",
                 "result/judging/definitions.toml"):  # fmt: skip
        assert changed[name] == [not name.startswith("result"), True], name
    assert changed["fmus/master/master.py"] == [False, True]
    assert changed["cli/app.py"] == [False, False]
    assert changed["scenarios/pick_and_place/scenario.toml"] == [False, False]
