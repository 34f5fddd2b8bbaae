"""Make the modules with which a page simulates, or compare them with those that are there.

    python .ci/engine.py [--check]

They are MuJoCo's own, from npm's package `@mujoco/mujoco`, of the version that package.json pins,
and the libraries of plant and controller, compiled for wasm32 with the headers of the same version
of MuJoCo. npm and ziglang are needed, which `panda-cosim[test]` brings. The same versions give the
same bytes.
"""

import base64
import hashlib
import json
import re
import subprocess
import sys
import zlib
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from panda_cosim.fmus.build.engines import made_with
from panda_cosim.fmus.build.libraries import PLACES, SOURCES, compile_library, licences
from panda_cosim.fmus.build.platforms import PAGE
from panda_cosim.result.view.page import ENGINE, NOTICE

SOURCE = Path(__file__).parents[1] / "src/panda_cosim/result/view/source"
# What the page calls, besides what FMUs call.
CALLED = (
    "malloc", "free", "mj_parseXMLString", "mj_compile", "mjs_getError", "mj_sizeModel",
    "mj_saveModel", "mj_deleteModel", "mj_deleteSpec",
)  # fmt: skip
# Libraries in MuJoCo's module; its others belong to renderers.
WITHIN = ("Collisions", "libccd", "LLVM runtime", "LodePNG", "MarchingCube", "Qhull", "TinyOBJ",
          "TinyXML2")  # fmt: skip


def modules() -> dict[str, bytes]:
    """Return all modules by name."""
    package = json.loads((SOURCE / "package.json").read_text(encoding="utf-8"))
    version = package["devDependencies"]["@mujoco/mujoco"]
    names = re.findall(r"X\((mj\w+)\)", (SOURCES / "mujoco_library.h").read_text(encoding="utf-8"))
    subprocess.run(["npm", "ci"], cwd=SOURCE, check=True, stdout=subprocess.DEVNULL)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "mujoco.wasm"
        command = ["node", "engine.mjs", str(file), *dict.fromkeys((*names, *CALLED))]
        subprocess.run(command, cwd=SOURCE, check=True)
        made = {"mujoco": file.read_bytes()}
    for backend in PLACES:
        compiled = made_with(version, partial(compile_library, backend, PAGE))
        made["plant" if backend == "mujoco" else backend] = compiled
    return made


def notice() -> str:
    """Return MuJoCo's licence, and those of the libraries in its module."""
    own = {name: text.decode() for name, text in licences("mujoco").items()}
    parts = re.split(r"\n(?=### )", own["LICENSES_THIRD_PARTY"])
    within = [part for part in parts if part.removeprefix("### ").startswith(WITHIN)]
    head = "Contains MuJoCo, under the Apache License 2.0, and in it the libraries below that."
    return "\n\n".join([head, own["LICENSE"].strip("\n"), *map(str.strip, within)]) + "\n"


def main() -> None:
    """Write the file, or say what differs."""
    made = modules()
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in made.items()}
    place = Path(__file__).parents[1] / "src/panda_cosim/result/view/page" / ENGINE
    if "--check" in sys.argv:
        there = json.loads(place.read_text(encoding="utf-8"))
        other = [name for name in digests if there[name]["sha256"] != digests[name]]
        sys.exit(f"{place}: other bytes of {', '.join(other)}" if other else 0)
    packed = {name: base64.b64encode(zlib.compress(made[name], 9)).decode() for name in made}
    content = {n: {"sha256": digests[n], "deflated": packed[n]} for n in made}
    place.write_text(json.dumps(content), encoding="utf-8")
    (place.parent / NOTICE).write_text(notice(), encoding="utf-8")
    print(*(f"{n}: {len(made[n])} bytes, {digests[n]}" for n in made), sep="\n")


if __name__ == "__main__":
    main()
