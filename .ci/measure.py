"""Measures what docs/measured.md says, and writes it: python .ci/measure.py [SECTION ...].

Without a section it measures all of them, which takes an hour on two idle cores. `--from DIR` takes
a finished sweep's folder instead of running the sweep again; of `contact`, `touch` and `routes`,
the folder of a sweep of each scenario.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
from scipy.stats import binomtest

from panda_cosim.fmus.errors import InputError
from panda_cosim.run.prepare import prepare
from panda_cosim.study.benchmark import LABELS
from panda_cosim.study.sweep.definition import load_sweep
from panda_cosim.study.sweep.sweeping import check_sweep

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "measured.md"
RUN = [sys.executable, "-m", "panda_cosim"]
DELAYS = (0.0, 0.001, 0.003, 0.006, 0.008, 0.012)  # [s]
ENGINES = ("3.10.0", "3.11.0", "3.14.0", "3.17.0")  # beside the installed MuJoCo
LARGEST = 12  # packages that are listed
LOOKS = (("640x480", "60"), ("640x480", "30"), ("640x480", "15"), ("320x240", "60"))
TASKS = ("pick_and_place_impedance", "wipe", "peg_in_hole", "stack_impedance", "open_door")
WORN = (
    "mismatch.preset=worn", "mismatch.seed=1:100:100", "controller.kp=0.5", "controller.ik_gain=5",
    "controller.error_filter=0.02",
)  # fmt: skip
QUALIFIED = ("pick_and_place", "push", "tutorial")
QUIET = ("--no-video", "--no-view", "--no-plot")
HARD = 40.0  # [N] what presses on the table with more is a collision, as in `collision`
OBSERVED = '\n[vary."controller.observer"]\nvalues = [true]\n'
NOISE, DELAY = "mismatch.joint_noise=1e-5", "mismatch.delay=0.001"
ERRORS: tuple[tuple[str, ...], ...] = (
    (), (NOISE,), (NOISE, "gains=robust"), (DELAY,), (DELAY, "controller.reading_delay=0.001"),
    ("mismatch.joint_offset=3.5e-4",),
)  # fmt: skip


def _said(command: Sequence[str], codes: Sequence[int] = (0, 3)) -> str:
    """What a command prints; it must end with one of some exit codes."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in codes:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def _numbers(values: Sequence[float], digits: int = 2) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _summary_of(scenario: str, *settings: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *RUN,
            "run",
            scenario,
            "--no-video",
            "--no-view",
            "--json",
            "--out",
            f"{folder}/r",
        ]
        command += [word for setting in settings for word in ("--set", setting)]
        summary: dict[str, Any] = json.loads(_said(command))["summary"]
    return summary


def runs(_: Path | None) -> str:
    """The task, as planned and as fast as the robot may go: `panda-cosim run SCENARIO`."""
    names = ("pick_and_place", "pick_and_place_fast")
    summaries = [_summary_of(name) for name in names]
    shares = {"position", "velocity", "torque", "torque_rate", "reference_acceleration"}
    rows = [
        ["cycle, s", *(f"{s['timing']['cycle_s']:.2f}" for s in summaries)],
        ["tracking RMS, mm", *(f"{s['tracking']['rms_mm']:.4f}" for s in summaries)],
        *(
            [label, *(f"{s['block'][key]:.2f}" for s in summaries)]
            for label, key in (
                ("place error, mm", "place_error_mm"),
                ("slip while carried, mm", "slip_mm"),
                ("drop at release, mm", "drop_mm"),
                ("force of setting down, N", "set_down_force_N"),
            )
        ),
        *(
            [f"largest share of the limit: {name.replace('_', ' ')}"]
            + [f"{max(s['limits'][f'{name}_share']):.2f}" for s in summaries]
            for name in sorted(shares)
        ),
    ]
    return _table(["", *(f"`{name}`" for name in names)], rows)


def errors(_: Path | None) -> str:
    """Each error of `calibrated` alone, and two remedies.

    `panda-cosim run pick_and_place --set KEY`, with the hand's pose from the controller's own model
    (`--set mismatch.hand_pose_source=model`).
    """
    rows = []
    for error in ERRORS:
        summary = _summary_of("pick_and_place", "mismatch.hand_pose_source=model", *error)
        tracking = summary["tracking"]
        rows.append([
            ", ".join(f"`{key}`" for key in error) or "none",
            f"{tracking['rms_mm']:.3f} ({tracking['max_mm']:.3f})",
            f"{summary['block']['place_error_mm']:.2f}",
            f"{max(summary['limits']['torque_rate_share']):.1f}",
        ])  # fmt: skip
    head = ["key", "tracking RMS (max), mm", "place error, mm", "torque rate, times the limit"]
    return _table(head, rows)


def margins(_: Path | None) -> str:
    """Disk margin at an update each ms: `panda-cosim analyze --set mismatch.delay=SECONDS`."""
    variants: dict[str, list[str]] = {"gauss-seidel": [], "jacobi": []}
    for delay in DELAYS:
        both = ("--coupling", "gauss-seidel,jacobi")
        command = [*RUN, "analyze", "--json", *both, "--set", f"mismatch.delay={delay}"]
        for variant in json.loads(_said(command))["variants"]:
            if variant["period"] == 0.001:
                margin = f"{variant['disk_margin']:.2f}" if variant["stable"] else "unstable"
                variants[variant["coupling"]].append(margin)
    return _table(["delay, s", *DELAYS], [[name, *values] for name, values in variants.items()])


def _rows(folder: Path | None, name: str, sweep: str, *varied: str) -> pa.Table:
    """Rows of a sweep: those in a subfolder, or of a new one."""
    with tempfile.TemporaryDirectory() as new:
        if folder is None:
            options = [word for key in varied for word in ("--vary", key)]
            _said([*RUN, "sweep", sweep, *options, "--out", f"{new}/{name}"])
        return ds.dataset((folder or Path(new)) / name / "results").to_table()


def _swept(name: str, folder: Path | None, *varied: str) -> str:
    rows = _rows(folder, "", name, *varied)
    succeeded = rows["status"].to_numpy() == "success"
    rate = binomtest(int(succeeded.sum()), len(rows)).proportion_ci(0.95)
    rates = _largest(rows, "torque_rate_share")
    measures = {
        "place error, mm": "block.place_error_mm",
        "slip while carried, mm": "block.slip_mm",
        "drop at release, mm": "block.drop_mm",
        "force of setting down, N": "block.set_down_force_N",
        "tracking RMS, mm": "tracking.rms_mm",
    }
    lines = [
        ["successful", f"{succeeded.sum()} of {len(rows)}: {100 * rate.low:.2f} to "
         f"{100 * rate.high:.2f} % (95 %, Clopper-Pearson)"],
        *(
            [f"{label}: median, 95 %, largest", _numbers(np.nanquantile(
                rows[f"summary.{key}"].to_numpy().astype(float), [0.5, 0.95, 1.0]), 3)]
            for label, key in measures.items()
        ),
        ["torque rate, times the robot's limit: median, largest; kept in",
         f"{np.median(rates):.2f}, {rates.max():.2f}; {np.count_nonzero(rates <= 1)}"],
    ]  # fmt: skip
    return _table(["result", "measured"], lines)


def _largest(rows: pa.Table, share: str) -> np.ndarray:
    names = [name for name in rows.column_names if name.startswith(f"summary.limits.{share}[")]
    return np.max([rows[name].to_numpy() for name in names], axis=0)


def box(folder: Path | None) -> str:
    """Blocks of random place, yaw, mass and friction: `panda-cosim sweep random_box`."""
    return _swept("random_box", folder)


def calibrated(folder: Path | None) -> str:
    """Random robots and cameras, calibrated well: `panda-cosim sweep calibrated`."""
    return _swept("calibrated", folder)


def worn(folder: Path | None) -> str:
    """Worn robots with the gains `robust`, judged as calibrated ones.

    `panda-cosim sweep calibrated --vary mismatch.preset=worn --vary mismatch.seed=1:100:100
    --vary controller.kp=0.5 --vary controller.ik_gain=5 --vary controller.error_filter=0.02`.
    """
    return _swept("calibrated", folder, *WORN)


def touch(folder: Path | None) -> str:
    """What the arm feels, with the default thresholds.

    `panda-cosim run collision`, whose force counts as held from 50 ms after the collision;
    `sweep calibrated --vary mismatch.seed=5001:5300:300 --vary controller.observer=true`; blocks of
    `random_box`, with two lines added to a copy of its file: `[vary."controller.observer"]`,
    `values = [true]`; `sweep calibrated_guarded --vary mismatch.seed=60000:60059:60`.
    """
    lines = []
    for reaction in ("stop", "none"):
        settings = (f"controller.reaction={reaction}", "controller.observer=true")
        criteria = _summary_of("collision", *settings)["criteria"]
        forces = _numbers([c["value"] for c in criteria], 0)
        lines.append(
            [f"pressed on the table, reaction `{reaction}`: force at most, held, N", forces]
        )
    with tempfile.TemporaryDirectory() as new:
        box = Path(new, "random_box.toml")
        text = (ROOT / "scenarios/sweeps/random_box.toml").read_text()
        text = text.replace("samples = 10000", "samples = 300")
        box.write_text(text + OBSERVED)
        varied = ("mismatch.seed=5001:5300:300", "controller.observer=true")
        tables = {
            "calibrated": _rows(folder, "calibrated", "calibrated", *varied),
            "random_box": _rows(folder, "random_box", str(box)),
        }
    for name, rows in tables.items():
        reported = rows["event.collision"].is_valid().to_numpy()
        force = rows["summary.block.set_down_force_N"].to_numpy().astype(float)
        softly = np.count_nonzero(reported & ~(force > HARD))
        lines.append([
            f"`{name}`: collisions reported; of these, with at most {HARD:g} N of setting down",
            f"{reported.sum()} of {len(rows)} runs; {softly}",
        ])  # fmt: skip
    rows = _rows(folder, "calibrated_guarded", "calibrated_guarded", "mismatch.seed=60000:60059:60")
    succeeded = np.count_nonzero(rows["status"].to_numpy() == "success")
    slip, force = (
        np.nanmax(rows[f"summary.block.{key}"].to_numpy().astype(float))
        for key in ("slip_mm", "set_down_force_N")
    )
    guarded = f"{succeeded} of {len(rows)}; {slip:.2f}, {force:.0f}"
    lines.append(
        ["`calibrated_guarded`: successful; slip, mm, and force on the table, N, at most", guarded]
    )
    return _table(["", "measured"], lines)


def time_step(_: Path | None) -> str:
    """Steps of the physics, with the controller at 1 ms: `python .ci/studies/time_step.py`."""
    return _said([sys.executable, ".ci/studies/time_step.py"]).strip()


def contact(folder: Path | None) -> str:
    """Tasks in contact by 100 calibrated robots each.

    `panda-cosim sweep SCENARIO --vary mismatch.seed=1:100:100`. A margin is the distance to a
    criterion's bound as a share of it.
    """
    lines = []
    for name in TASKS:
        rows = _rows(folder, name, name, "mismatch.seed=1:100:100")
        succeeded, margins = rows["status"].to_numpy() == "success", rows["margin"].to_numpy()
        missed = ", ".join(sorted({m for m in rows["missed"].to_pylist() if m})) or "none"
        rates = _largest(rows, "torque_rate_share")
        share = f"{np.median(rates):.2f}, {rates.max():.2f}"
        spread = f"{np.nanmedian(margins):.2f}, {np.nanmin(margins):.2f}"
        lines.append([f"`{name}`", f"{succeeded.sum()} of {len(rows)}", missed, spread, share])
    head = ["scenario", "successful", "criteria missed", "smallest margin: median, lowest"]
    return _table([*head, "torque rate, times the robot's limit: median, largest"], lines)


def moves(_: Path | None) -> str:
    """Random straight moves, up to 120 deg, 0.5 m/s and 1 rad/s.

    `python .ci/studies/random_moves.py`: 500 from `home`, with `--touch`; with `--retimed`, where
    each gets the time that it needs; and with `--starts --count 100`, from random joint positions.
    """
    ways = (["--touch"], ["--retimed"], ["--starts", "--count", "100"])
    texts = [
        _said([sys.executable, ".ci/studies/random_moves.py", *option], (0, 1)) for option in ways
    ]
    return "\n".join(
        f"- {line[0].upper()}{line[1:]}."
        for text in texts
        for line in text.splitlines()
        if not line.startswith("move ")
    )


def routes(folder: Path | None) -> str:
    """Planned routes: `panda-cosim sweep anywhere` and `panda-cosim sweep behind_wall`.

    The first has blocks of any azimuth and yaw, 0.25 to 0.90 m from the arm's axis, the second a
    wall between block and place. A plan's processor time is that of the preparation of a row.
    """
    lines = []
    for name in ("anywhere", "behind_wall"):
        rows = _rows(folder, name, name)
        succeeded = np.count_nonzero(rows["status"].to_numpy() == "success")
        forces = rows["summary.contact.unwanted_force_N"].to_numpy().astype(float)
        limits = [n for n in rows.column_names if re.match(r"summary\.limits\..*_share\b", n)]
        shares = [np.nanmax(rows[n].to_numpy().astype(float)) for n in limits]
        plans = _numbers(np.quantile(_plan_times(name), [0.5, 0.95, 1.0]), 2)
        unwanted = np.count_nonzero(forces > 0)
        lines.append(
            [f"`{name}`", f"{succeeded} of {len(rows)}", unwanted, f"{max(shares):.3f}", plans]
        )
    head = ["sweep", "successful", "with unwanted contact", "largest share of a limit"]
    return _table([*head, "plan, s of processor time: median, 95 %, largest"], lines)


def _plan_times(name: str) -> list[float]:
    """Processor time of preparing each row of a sweep [s]."""
    scenarios, design = check_sweep(load_sweep(name), None)
    times = []
    for index in range(len(design)):
        scenario = scenarios[design.scenario(index)].scenario
        began = time.process_time()
        with suppress(InputError):  # there is no route, which takes its time, too
            prepare(scenario.changed(design.values(index)))
        times.append(time.process_time() - began)
    return times


def mink(_: Path | None) -> str:
    """Our law beside the inverse kinematics of mink, over the same random moves.

    `python .ci/studies/mink_moves.py`, with the same servos and without FMUs.
    """
    return _said([sys.executable, ".ci/studies/mink_moves.py"]).strip()


def cost(_: Path | None) -> str:
    """A step of `pick_and_place`, alternating in one process: `panda-cosim bench`.

    Medians of processor time; ratios with their quartiles.
    """
    results = []
    for kind in ("native", "python"):
        with tempfile.TemporaryDirectory() as folder:
            _said([*RUN, "bench", "--kind", kind, "--json", f"{folder}/b.json"])
            results.append(json.loads(Path(folder, "b.json").read_text()))
    spread = "{median:.2f} ({low:.2f} to {high:.2f})".format
    rows = [
        *([f"{LABELS[way]}, us", *(f"{r['steps'][way]['median']:.1f}" for r in results)]
          for way in results[0]["steps"]),
        *([ratio, *(spread(**r["ratios"][ratio]) for r in results)]
          for ratio in results[0]["ratios"]),
        *([f"`{command}`, s", *(f"{r['start_up'][command]:.2f}" for r in results)]
          for command in results[0]["start_up"]),
    ]  # fmt: skip
    return _table(["", "native FMUs", "Python FMUs"], rows)


def wire(_: Path | None) -> str:
    """A program on pylibfranka, in step with the plant: `.ci/studies/wire.py`, 4,000 ticks each.

    Ticks per second of wall time, with the program's own work, and the machine's load meanwhile.
    Beside it the simulator franky-sim with the same program, if this command is there. It follows
    the wall clock, so that 1,000 is the most it can do.
    """
    program = ROOT / ".ci" / "studies" / "wire.py"
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "rates.json")
        command = json.dumps(["python", str(program), "{address}", str(result)])
        Path(folder, "scenario.toml").write_text(
            'duration = 60.0\nscene = "motors"\nrobot = "fr3"\ncontroller = "franka"\n'
            f"[client]\ncommand = {command}\n"
        )
        _said([*RUN, "run", folder, "--out", f"{folder}/run", *QUIET])
        rows = [_rates("panda-cosim", result)]
        if shutil.which("franky-sim"):
            address = "127.0.0.1"
            line = ["franky-sim", "--simulator", "mujoco", "--hostname", address]
            with subprocess.Popen(line, env={**os.environ, "PYTHONUNBUFFERED": "1"},
                                  stdout=subprocess.PIPE, text=True) as server:  # fmt: skip
                next(text for text in server.stdout or () if "Press Ctrl+C" in text)
                _said([sys.executable, str(program), address, str(result)])
                server.terminate()
            rows.append(_rates("franky-sim", result))
    return _table([*rows[0]], [[*row.values()] for row in rows])


def _rates(simulator: str, result: Path) -> dict[str, str]:
    rates = {way: f"{rate:.0f}" for way, rate in json.loads(result.read_text()).items()}
    load = f"{os.getloadavg()[0]:.2f}"
    return {"simulator": simulator, **rates, "load in the last minute": load}


def engines(_: Path | None) -> str:
    """Shipped scenarios by version of MuJoCo: `panda-cosim regress --no-sweeps --mujoco LIST`.

    Against the installed one, whose references they are held against, too.
    """
    command = [*RUN, "regress", "--no-sweeps", "--json", "--mujoco", ",".join(ENGINES)]
    outcomes = json.loads(_said(command, (0, 1)))["scenarios"]
    width = 1 + len(ENGINES)
    rows = [outcomes[i : i + width] for i in range(0, len(outcomes), width)]
    return _table(
        ["scenario", *ENGINES],
        [[f"`{own['name']}`", *map(_on_engine, others)] for own, *others in rows],
    )


def noticed(_: Path | None) -> str:
    """What three scenarios notice if each parameter is 5 % larger; those that only one notices."""
    said = json.loads(_said([*RUN, "regress", *QUALIFIED, "--qualify", "0.05", "--json"]))
    changes = said["changes"]
    rows = [
        (f"`{each['key']}`", each["change"], *each["noticed"][0])
        for each in changes if len(each["noticed"]) == 1
    ]  # fmt: skip
    words = {
        "noticed by several": [it for it in changes if len(it["noticed"]) > 1],
        "not noticed": [it for it in changes if it["state"] == "not noticed"],
        "without effect": [it for it in changes if it["state"] == "no effect"],
    }
    lists = [f"{word}: " + ", ".join(f"`{it['key']}`" for it in its) for word, its in words.items()]
    score = f"{said['score']:.0%} of the changes with an effect are noticed"
    head = ("parameter", "change", "noticed by", "what first")
    return f"{_table(head, rows)}\n\n{score}; {'; '.join(lists)}."


def _on_engine(outcome: dict[str, Any]) -> str:
    if outcome["verdict"] == "same":
        return str(outcome["difference"])
    first, worst = outcome["first"], outcome["worst"]
    if first is None:
        return f"{outcome['difference']}; **{outcome['verdict']}**: {outcome['reason']}"
    return (
        f"{outcome['difference']}; **`{first['name']}` leaves its tube at {first['first']:.3f} s**"
        f", at most {worst['share']:.1f} tolerances"
    )


def _processor(pid: int | str = "self") -> float:
    """Processor time of a process and of the ended ones that it started [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def install(_: Path | None) -> str:
    """README's first command, in a new clone and with nothing cached: what is there after how long.

    Of packages, what pip has installed then.
    """
    with tempfile.TemporaryDirectory() as folder:
        clone, bin_ = Path(folder, "clone"), Path(folder, "clone", ".venv", "bin")
        _said(["git", "clone", "--quiet", str(ROOT), str(clone)])
        began, before = time.monotonic(), _processor()
        _said([sys.executable, "-m", "venv", str(clone / ".venv")])
        _said([f"{bin_}/pip", "install", "--no-cache-dir", "--no-compile", "-e", str(clone)])
        spent = _processor() - before
        rows = [["the package is installed", f"{spent:.0f}", f"{time.monotonic() - began:.0f}"]]
        sizes = _sizes(next(clone.glob(".venv/lib/*/site-packages")))
        run = subprocess.Popen(
            [f"{bin_}/panda-cosim", "run"],
            cwd=clone,
            env=os.environ | {"PANDA_COSIM_CACHE": f"{folder}/cache"},
            stdout=subprocess.PIPE,
            text=True,
        )
        for line in run.stdout or ():
            if landed := re.search(r"^Success|[\w.]+(?=  [\d.]+ [kM]B$)", line):
                now = (spent + _processor(run.pid), time.monotonic() - began)
                rows.append([f"`{landed[0]}`", *(f"{seconds:.0f}" for seconds in now)])
        if run.wait():
            raise SystemExit(f"the run ended with {run.returncode}")
    both = (_table(["", "processor, s", "wall, s"], rows), _table(["package", "MB"], sizes))
    return "\n\n".join(both)


def _sizes(site: Path) -> list[list[str]]:
    """Sizes of the largest installed packages, of the others and of all."""
    packages = distributions(path=[str(site)])
    sizes = {
        package.name: sum(
            file.stat().st_size
            for file in (Path(str(entry.locate())) for entry in package.files or ())
            if file.is_file()
        ) / 1e6
        for package in packages
    }  # fmt: skip
    largest = sorted(sizes.items(), key=lambda item: -item[1])[:LARGEST]
    rest, total = sum(sizes.values()) - sum(size for _, size in largest), sum(sizes.values())
    shown = [*largest, (f"{len(sizes) - LARGEST} others", rest), ("all", total)]
    return [[name, f"{size:.0f}"] for name, size in shown]


def video(_: Path | None) -> str:
    """What a second of video costs: `panda-cosim render RUN --size WxH --fps HZ`, without a GPU.

    Of the first two seconds of `pick_and_place`, less what `--no-video` takes.
    """
    rows: list[tuple[str, float, float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        run = f"{folder}/run"
        _said([*RUN, "run", "--duration", "2", "--no-video", "--no-view", "--out", run])
        for look in ((), *LOOKS):
            out = Path(folder, f"pictures{len(rows)}")
            options = ["--size", look[0], "--fps", look[1]] if look else ["--no-video"]
            before, began = _processor(), time.monotonic()
            _said([*RUN, "render", run, "--out", str(out), *options])
            cost = (_processor() - before, time.monotonic() - began)
            size = (out / "video.mp4").stat().st_size / 1e3 if look else 0.0
            rows.append((", ".join(look), *cost, size))
    nothing, *videos = rows
    return _table(
        ["size, frames a second", "processor, s", "wall, s", "kB"],
        [[look, f"{(cpu - nothing[1]) / 2:.1f}", f"{(wall - nothing[2]) / 2:.1f}", f"{kB / 2:.0f}"]
         for look, cpu, wall, kB in videos],
    )  # fmt: skip


SECTIONS: dict[str, Callable[[Path | None], str]] = {
    "runs": runs, "errors": errors, "margins": margins, "box": box, "calibrated": calibrated,
    "worn": worn, "contact": contact, "touch": touch, "step": time_step,
    "moves": moves, "routes": routes, "mink": mink, "cost": cost, "install": install,
    "video": video, "engines": engines, "wire": wire, "noticed": noticed,
}  # fmt: skip


def write(name: str, text: str) -> None:
    """Replace a section of the page, with the date, the commit and the machine."""
    commit = _said(["git", "rev-parse", "--short", "HEAD"]).strip()
    cpu = next(
        (line.partition(":")[2].strip() for line in _cpu_lines() if line.startswith("model name")),
        platform.processor(),
    )
    where = f"{datetime.now(UTC):%Y-%m-%d}, commit {commit}, {os.cpu_count()} cores of {cpu}"
    body = f"{' '.join((SECTIONS[name].__doc__ or '').split())}\n\n{text}\n\nMeasured {where}.\n"
    marked = f"<!-- {name}: begin -->\n{body}<!-- {name}: end -->"
    pattern = re.compile(rf"<!-- {name}: begin -->.*?<!-- {name}: end -->", re.DOTALL)
    page, replaced = pattern.subn(lambda _: marked, PAGE.read_text())
    if replaced != 1:
        raise SystemExit(f"{PAGE}: has no section {name}")
    PAGE.write_text(page)


def _cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def main() -> None:
    """Measure sections, and write each as it is done."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, []], metavar="SECTION")
    parser.add_argument("--from", dest="folder", type=Path, metavar="DIR")
    options = parser.parse_args()
    for name in options.sections or SECTIONS:
        write(name, SECTIONS[name](options.folder))
        print(f"measured {name}", flush=True)


if __name__ == "__main__":
    main()
