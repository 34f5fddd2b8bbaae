"""The built page code is what its source says: rebuilt to the same code, and tested."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import zlib
from pathlib import Path

import pytest

from bounded import ran

VIEW = Path(__file__).parent.parent / "src" / "panda_cosim" / "show" / "view"
BUILT = ("LICENSES.txt", "code.json", "differences.css", "sweep.css", "view.css")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of the source with the locked libraries in it."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("no node and npm here")
    folder = tmp_path_factory.mktemp("build") / "source"
    shutil.copytree(VIEW / "source", folder, ignore=shutil.ignore_patterns("node_modules"))
    command = ["npm", "ci", "--prefer-offline"]
    done = ran(command, cwd=folder, code=None)
    unreachable = ("ENOTFOUND", "EAI_AGAIN", "ECONNREFUSED", "ETIMEDOUT", "ENETUNREACH")
    if done.returncode and any(word in done.stderr for word in unreachable):
        pytest.skip("npm reaches no registry from here")
    assert done.returncode == 0, done.stderr
    return folder


def node(folder: Path, *command: str) -> None:
    """Run a command in the source's folder."""
    ran(command, cwd=folder)


def content(file: Path) -> dict[str, bytes]:
    """A built file; code as it runs, since another zlib may deflate it to other bytes."""
    if file.suffix != ".json":
        return {file.name: file.read_bytes()}
    return {name: code_of(built) for name, built in json.loads(file.read_text()).items()}


def code_of(built: dict[str, str]) -> bytes:
    """Return a bundle's code, which the pages' policy allows by this digest."""
    if "text" in built:
        code = built["text"].encode()
    else:
        code = zlib.decompress(base64.b64decode(built["deflated"]))
    assert base64.b64encode(hashlib.sha256(code).digest()).decode() == built["sha256"]
    return code


def test_rebuilding_gives_the_same_code(source, tmp_path):
    node(source, "node", "build.mjs", str(tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(BUILT)
    for name in BUILT:
        assert content(tmp_path / name) == content(VIEW / "page" / name), name


def test_the_page_codes_own_tests_pass(source):
    """Its types are checked with those of Python, by `.ci/run`."""
    node(source, "npm", "test")


def test_the_bundle_carries_its_licences_and_asks_nobody():
    notice = (VIEW / "page" / "LICENSES.txt").read_text(encoding="utf-8")
    versions = json.loads((VIEW / "source" / "package.json").read_text())["dependencies"]
    bundles = content(VIEW / "page" / "code.json")
    for name, version in versions.items():
        assert f"{name} {version}" in notice
        assert f"{name} {version}".encode() in bundles["view"]
    assert notice.count("Permission is hereby granted") == len(versions)
    assert notice.encode() in bundles["view"]
    for word in ("fetch(", "WebSocket", "innerHTML", "eval(", "importScripts"):
        ours = [path for path in (VIEW / "source/src").rglob("*.ts") if word in path.read_text()]
        # A live run's page speaks to its server; its policy allows no other, a file's none.
        assert [path.name for path in ours] == (["link.ts"] if word == "WebSocket" else []), word
