"""The digests of FMUs and sweeps change with everything that FMUs and rows depend on."""

import tomllib
from pathlib import Path

import grimp
import pytest

from panda_cosim.fmus.build import identity
from panda_cosim.study.sweep import store

ROOT = Path(__file__).parents[2]


def above(container: str, layer: str) -> set[str]:
    """What is above a layer within a package."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (names,) = (c["layers"] for c in settings["contracts"] if c.get("containers") == [container])
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
def hashed():
    """The files in the digest of FMUs, and in that of sweeps."""
    files: list[set[str]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identity, "digest", lambda code, *_: files.append({*code}))
        for folders in (identity.ABOVE, store.ABOVE):
            identity.code_digest.__wrapped__(folders)
    return files


@pytest.fixture(scope="module")
def graph():
    """What each module imports."""
    return grimp.build_graph("panda_cosim", cache_dir=None, exclude_type_checking_imports=True)


@pytest.mark.parametrize(
    ("digest", "module"),
    [(0, "fmus.sources.targets"), (0, "fmus.inside.plant"), (0, "fmus.inside.controller"),
     (1, "study.sweep.row"), (1, "study.sweep.design"), (1, "controller.controller")],
)  # fmt: skip
def test_a_digest_changes_with_each_module_that_is_imported(hashed, graph, digest, module):
    needed = {*graph.find_upstream_modules(f"panda_cosim.{module}"), f"panda_cosim.{module}"}
    for name in needed - {"panda_cosim"}:
        place = name.removeprefix("panda_cosim.").replace(".", "/")
        assert hashed[digest] & {f"{place}.py", f"{place}/__init__.py"}, place
    assert len(needed) > 5


def test_a_digest_changes_with_data_and_c_but_not_with_what_is_above(hashed):
    of_fmus, of_sweeps = hashed
    assert of_fmus >= {"fmus/native/step.c", "fmus/native/instance.h", "assets/arm.xml"}
    only_sweeps = {"result/judging/definitions.toml", "fmus/master/master.py"}
    assert of_sweeps > of_fmus | only_sweeps
    assert not of_fmus & only_sweeps
    assert not of_sweeps & {"cli/app.py", "scenarios/pick_and_place/scenario.toml"}
