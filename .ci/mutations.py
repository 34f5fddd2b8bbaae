"""Damages files; each is used, or refused in one line: `python .ci/mutations.py 200 [KIND]`."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from panda_cosim import Session, run_scenario

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from forked import command
from sweep_support import made_up, write_sweep

LIMIT = 60.0  # [s] for a command; a sweep that goes on has been accepted
TABLES = ("check", "regress")  # commands that tell in their tables what they refuse
BAD = re.compile(r"please report it|Traceback|\.py:\d+: \w*Warning|\w(Error|Exception)\(")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NUMBERS = ("1e308", "1e-320", "1e999", "nan", "inf", "-0.0", "-1", "0", "9" * 400, "2147483648",
           "1_000", "0x10", "1e", "", '""', "true", "[]", "{}", "null", "१२", "1,5")  # fmt: skip
ODD = ("\0", "\x1b[31m", "\ufeff", "\u202e", "\u0430", "\u2028", "\r", "'", '"', "\\", "\\ud800",
       "&#0;", "<!--", "]]>", "%s", "{0}", "../", "e\u0301", "=", "[", "#", ",", "\n")  # fmt: skip
VALUES = (None, True, -1, 0, 1e308, 5e-324, 10**30, 1.5, "", "x", "\0", "\u202e<b>", [], {}, [[1]],
          {"a": 1}, float("nan"), float("inf"), "x" * 10_000, [None], "../x")  # fmt: skip
LAW = """
class Law:
    gain = 20.0  # 1/s, a tunable parameter

    def update(self, time, pos_cmd, hand_xpos, qpos):
        return [q + 0.001 * self.gain * (pos_cmd[2] - hand_xpos[2]) for q in qpos[:7]] + [0.0]
"""


def of_bytes(chance: Random, data: bytes) -> bytes:
    """Flip bits; cut or zero a part; or put something in."""
    changed, at = bytearray(data or b"x"), chance.randrange(len(data) or 1)
    end = at + chance.choice((1, 8, 100, len(data) // 3))
    match chance.randrange(6):
        case 0 | 1:
            del changed[at : chance.choice((end, len(changed)))]
        case 2:
            changed[at:end] = bytes(len(changed[at:end]))
        case 3:
            changed[at:at] = chance.randbytes(end - at)
        case _:  # often at the end, where parquet and zip have their tables of contents
            for _ in range(chance.choice((1, 20))):
                last = chance.choice((len(changed), min(len(changed), 600)))
                changed[-chance.randrange(1, last + 1)] ^= 1 << chance.randrange(8)
    return bytes(changed)


def of_text(chance: Random, data: bytes) -> bytes:
    """Put in an odd number, character, line, key, encoding or length."""
    text = data.decode("utf-8", "replace") or "\n"
    lines, at = text.splitlines(keepends=True), chance.randrange(len(text))
    row, other = chance.choices(range(len(lines)), k=2)
    match chance.randrange(10):
        case 0 | 1 | 2 if places := list(NUMBER.finditer(text)):
            place = chance.choice(places)
            text = text[: place.start()] + chance.choice(NUMBERS) + text[place.end() :]
        case 3:
            text = text[:at] + chance.choice(ODD) + text[at + chance.randrange(2) :]
        case 4 | 5:  # a line that is missing, twice, or elsewhere
            lines[row] = chance.choice(("", lines[other], lines[row] * 2))
            text = "".join(lines)
        case 6:
            return text.encode(chance.choice(("utf-16", "utf-32", "utf-8-sig", "cp037")), "replace")
        case 7:
            text = text[:at] + chance.choice("[{(<9\"' ") * chance.choice((300, 20_000)) + text[at:]
        case 8:
            words = sorted(set(re.findall(r"[A-Za-z_]{3,}", text))) or ["x"]
            new = chance.choice([*words, "nan", "__proto__", "x" * 10_000])
            text = text.replace(chance.choice(words), new, chance.choice((1, -1)))
        case _:
            return of_bytes(chance, data)
    return text.encode("utf-8", "surrogatepass")


def of_json(chance: Random, data: bytes) -> bytes:
    """Replace a value, in one of the lines if there are several."""
    lines = data.decode().splitlines()
    row = chance.randrange(len(lines)) if lines[0].endswith("}") else slice(None)
    value = json.loads(lines[row] if isinstance(row, int) else "\n".join(lines))
    places = list(_places(value))
    if not places or chance.random() < 0.3:
        return of_text(chance, data)
    holder, key = chance.choice(places)
    holder[key] = chance.choice(VALUES)
    lines[row] = json.dumps(value) if isinstance(row, int) else [json.dumps(value)]
    return "\n".join(lines).encode()


def _places(value: Any) -> list[tuple[Any, Any]]:
    if not isinstance(value, (dict, list)):
        return []
    keys = list(value) if isinstance(value, dict) else range(len(value))
    return [(value, key) for key in keys] + [each for key in keys for each in _places(value[key])]


def of_parquet(chance: Random, data: bytes) -> bytes:
    """Change bytes, metadata, rows, or the name, type or values of a column."""
    table = pq.read_table(io.BytesIO(data))
    number, rows = chance.randrange(table.num_columns), table.num_rows
    name, metadata = table.column_names[number], dict(table.schema.metadata or {})
    value = chance.choice((float("nan"), float("inf"), 1e308, 1e-320, -1.0, "x", True, None, [1.0]))
    match chance.randrange(8):
        case 0 | 1:
            return of_bytes(chance, data)
        case 2 if metadata:
            key = chance.choice(sorted(metadata))
            table = table.replace_schema_metadata({**metadata, key: of_text(chance, metadata[key])})
        case 3 | 4:
            tables = table.slice(0, 1), table.drop_columns([name]), pa.concat_tables([table, table])
            table = chance.choice(tables)
        case 5:
            names = table.column_names
            names[number] = chance.choice(("", "\0", "a.b[", "x" * 10_000, "time", f"{name}[1]"))
            table = table.rename_columns(names)
        case 6:
            table = table.set_column(number, name, pa.array([value] * rows))
        case _:
            cells, at = table.column(number).to_pylist(), chance.randrange(rows)
            cells[at] = value if isinstance(value, type(cells[at])) else cells[rows - 1 - at]
            table = table.set_column(number, name, pa.array(cells))
    pq.write_table(table, target := io.BytesIO())
    return target.getvalue()


def of_archive(chance: Random, data: bytes) -> bytes:
    """Change a text in an archive, its members, or its table of contents; never a library."""
    source = zipfile.ZipFile(io.BytesIO(data))
    members = [(name, source.read(name)) for name in source.namelist()]
    texts = [i for i, (name, _) in enumerate(members) if name.endswith((".xml", ".ssd", ".txt"))]
    at = chance.choice(texts)
    name, content = members[at]
    odd = (name.upper(), "../up", "/tmp/absolute", "C:\\x", "x" * 5000, "a/./b", "/", "\u202ename")
    match chance.randrange(7):
        case 0:
            begin = data.rfind(b"PK\x01\x02", 0, len(data) - chance.randrange(400))
            return data[:begin] + of_bytes(chance, data[begin:])
        case 1 | 2:
            members[chance.randrange(len(members))] = chance.choice(odd), content
        case _:
            members[at] = name, of_text(chance, content)
    with zipfile.ZipFile(target := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return target.getvalue()


RUN = "--no-video --no-view --out out"
# File to damage, how, and the commands that read it; they take turns.
KINDS: dict[str, tuple[str, Callable[[Random, bytes], bytes], list[str]]] = {
    "recording": ("run/recording.parquet", of_parquet,
                  ["export run out.csv", "view run --out out.html", "compare other run --out out",
                   "compare run other", "plot run --out out"]),
    "summary": ("run/summary.json", of_json,
                ["compare other run --out out", "view run --out out.html", "plot run --out out"]),
    "reference": ("short/reference.parquet", of_parquet,
                  ["check short", "view run --against short --out out.html", "regress short"]),
    "scenario": ("short/scenario.toml", of_text,
                 ["check short", f"run short {RUN}", "list", "info short"]),
    "trajectory": ("short/trajectory.csv", of_text,
                   ["check short", f"run short {RUN}", "retime short --out out",
                    "inputs short out.csv"]),
    "sweep": ("sweep.toml", of_text, ["sweep sweep.toml --out out"]),
    "sweep.json": ("swept/sweep.json", of_json,
                   ["sweep report swept --out out.html", "sweep promote swept 3 o"]),
    "results": ("swept/results/part-00000001.parquet", of_parquet,
                ["sweep report swept --out out.html"]),
    "mjcf": ("box.xml", of_text, ["mjcf2fmu box.xml --out out.fmu"]),
    "session": ("session/session.jsonl", of_json, [f"replay session {RUN}"]),
    "fmu": ("law.fmu", of_archive, ["info law.fmu", f"run short --controller law.fmu {RUN}"]),
    "ssp": ("Panda.ssp", of_archive,
            ["info Panda.ssp", f"run --system Panda.ssp --duration 0.02 {RUN}"]),
    "law": ("law.py", of_text, [f"run short --controller law.py:Law {RUN}"]),
}  # fmt: skip


def good_files(folder: Path) -> None:
    """Write a good file of each kind."""
    write_sweep(folder, 4, 'design = "random"\nkeep = "failures"\n')
    made_up(folder / "swept", 200)
    run_scenario(folder / "short", folder / "run")
    run_scenario(folder / "short", folder / "other", values={"controller.kp": 6})
    with Session(folder / "short", folder / "session") as session:
        session.set("controller.kp", 6)
        session.step(40)
        session.move_waypoint(1, position=(0, 0, 0.006))
    (folder / "law.py").write_text(LAW)
    shutil.copy(Path(__file__).parents[1] / "tests" / "mjcf" / "box.xml", folder)
    for line in ("regress short --update --yes", "build --out ."):
        assert command(*line.split(), cwd=folder).returncode == 0, line
    (folder / "PandaController.fmu").rename(folder / "law.fmu")


def listed(folder: Path) -> set[tuple[str, int]]:
    """Files, with times."""
    return {(str(p), p.stat().st_mtime_ns) for p in folder.rglob("*") if not p.is_dir()}


def fault(good: Path, kind: str, number: int) -> str:
    """Damage a file and run a command; returns what is wrong with how it ends."""
    name, mutate, lines = KINDS[kind]
    line, chance = lines[number % len(lines)].split(), Random(f"{kind} {number}")
    with tempfile.TemporaryDirectory(prefix="mutation-") as place:
        shutil.copytree(good, place, dirs_exist_ok=True, copy_function=os.link)
        damaged = mutate(chance, Path(place, name).read_bytes())
        Path(place, name).unlink()
        Path(place, name).write_bytes(damaged)
        before = listed(Path(place))
        try:
            done = command(*line, cwd=Path(place), timeout=LIMIT)
        except subprocess.TimeoutExpired:
            return "" if kind == "sweep" else f"{line}: hangs"
        new = listed(Path(place)) - before
    code, output = done.returncode, done.stdout + done.stderr
    errors = [each for each in output.splitlines() if each.startswith("Error:")]
    codes = (0, 1, 2, 3) if line[0] in ("run", "regress") else (0, 2, 3)
    faults = {
        f"exit code {code}": code not in codes,
        "a fault of the program": "FMU's code cannot start" not in output and BAD.search(output),
        f"{len(errors)} errors": code == 2 and len(errors) != 1 and line[0] not in TABLES,
        f"refused, but wrote {new}": code == 2 and new,
    }  # fmt: skip
    wrong = ", ".join(name for name, holds in faults.items() if holds)
    return wrong and f"{kind} {number}, {' '.join(line)}: {wrong}\n{output[-1500:]}"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        good_files(Path(folder))
        for kind in sys.argv[2:] or KINDS:
            faults = [fault(Path(folder), kind, number) for number in range(int(sys.argv[1]))]
            print(f"{kind}: {sum(map(bool, faults))} faults", *filter(None, faults), sep="\n")
