"""Files from elsewhere are data: only running an FMU runs what is in it."""

from __future__ import annotations

import ast
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import panda_cosim.fmus
import pytest
from fault_support import build_faulty, write_scenario
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.interface.parameters import expand, parse_assignment
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.scenarios.definition.scenario import Scenario
from panda_cosim.scenarios.recording import Recording

ROOT = Path(panda_cosim.fmus.__file__).parents[1]
SOURCES = sorted(
    path
    for package in ("assets", "plant", "controller", "fmus", "scenarios")
    for path in (ROOT / package).rglob("*.py")
)
# What turns data into code.
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "code"}
CALLS = {"eval", "exec", "compile", "execfile", "system", "popen", "runpy", "run_path"}


def dangers(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in MODULES:
            yield str(node.module)
        elif isinstance(node, ast.Call):
            yield from dangerous_call(node)


def dangerous_call(node: ast.Call) -> Iterator[str]:
    owner = ast.unparse(node.func)
    if owner in CALLS or owner in ("os.system", "os.popen", "runpy.run_path", "yaml.load"):
        yield owner
    for keyword in node.keywords:
        value = getattr(keyword.value, "value", None)
        if keyword.arg in ("shell", "allow_pickle") and value is not False:
            yield f"{owner}({keyword.arg}=...)"
    if owner.endswith(("np.load", "numpy.load")):
        yield owner


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_code_turns_data_into_code(path: Path) -> None:
    assert list(dangers(ast.parse(path.read_text(encoding="utf-8")))) == []


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from marshal import loads", "eval(x)", "np.load(f)", "os.system(x)",
     "subprocess.run(x, shell=True)", "f(allow_pickle=True)"],
)  # fmt: skip
def test_the_look_at_the_code_sees(source: str) -> None:
    assert list(dangers(ast.parse(source)))


CODE = "__import__('pathlib').Path('{mark}').touch()"


def test_code_in_a_scenario_is_text(tmp_path: Path) -> None:
    code = CODE.format(mark=tmp_path / "mark")
    folder = write_scenario(tmp_path / "scenario")
    toml = folder / "scenario.toml"
    toml.write_text(toml.read_text().replace('"short"', f'"{code}"'))
    assert Scenario.read(folder).purpose == code
    toml.write_text(toml.read_text().replace('"tabletop"', f'"{code}"'))
    with pytest.raises(InputError, match="must be one of"):
        Scenario.read(folder)
    table = folder / "trajectory.csv"
    toml.write_text(toml.read_text().replace(f'scene = "{code}"', ""))
    table.write_text(table.read_text().replace("0.02", code))
    with pytest.raises(InputError, match="must be a number"):
        Scenario.read(folder)
    instance, name, value = parse_assignment(f"plant.block_mass={code}", tuple(INTERFACES))
    with pytest.raises(InputError, match="is no number"):
        expand(instance, INTERFACES[instance], {name: value})
    assert not (tmp_path / "mark").exists()


def test_describing_an_fmu_runs_nothing_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = build_faulty(tmp_path)
    mark = tmp_path / "mark"
    leave_mark = f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode()
    changed = tmp_path / "changed.fmu"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(changed, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith(".py"):
                content = (
                    f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode() + content
                )
            target.writestr(name, content)
        for name in ("sitecustomize.py", "resources/x.pth", "conftest.py"):
            target.writestr(name, leave_mark)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    assert Fmu(changed).variable("qpos[1]").causality == "output"
    assert not mark.exists()


def test_a_recording_that_is_a_pickle_is_no_recording(tmp_path: Path) -> None:
    class_call = b"cpathlib\nPath\n(S'" + str(tmp_path / "mark").encode() + b"'\ntRctouch\n."
    for name in ("recording.parquet", "recording.arrows"):
        (tmp_path / name).write_bytes(class_call)
        with pytest.raises(InputError):
            Recording.open(tmp_path / name)
    assert not (tmp_path / "mark").exists()
    shutil.rmtree(tmp_path)
