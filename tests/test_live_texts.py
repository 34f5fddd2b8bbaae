"""The live page shows texts as text; clients that stall or flood hold nothing up."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any, ClassVar
from urllib.parse import urlsplit

import mujoco
import numpy as np
import pytest
from browser import Page
from crafted_texts import HEBREW, HIDDEN, ODD
from live_support import READY, upgrade
from panda_cosim.fmus.errors import InputError
from panda_cosim.scenarios.live import server as server_module
from panda_cosim.scenarios.live.commands import Set
from panda_cosim.scenarios.live.server import LiveServer
from panda_cosim.scenarios.live.simulation import Simulation
from panda_cosim.scenarios.view.model import describe
from panda_cosim.scenarios.view.page import live_page
from view_support import MODEL

TUNABLES = {f"{ODD}.p": 1.0, f"{ODD}.on": True, f"{ODD}.kind": ODD}
PLAN = {
    "time": [0.0, 1.0],
    "points": [0.3, 0.0, 0.5, 0.4, 0.0, 0.5],
    "waypoints": [{"time": 0.5, "label": ODD, "place": [0.3, 0.0, 0.5]}],
}


class Told:
    """Stands for a simulation: it refuses all commands."""

    history = (np.zeros(16),)

    def status(self) -> dict[str, Any]:
        """Return a status with a text in each place."""
        return {"run": 1, "playing": False, "over": False, "speed": 1.0, "coupling": ODD,
                "values": TUNABLES, "behind": 1.5, "folder": ODD, "message": HEBREW}  # fmt: skip

    def plan(self) -> dict[str, Any]:
        """Return a path with one waypoint."""
        return PLAN

    def ask(self, _command: object, refuse: Callable[[str], None]) -> None:
        """Refuse."""
        refuse(ODD)


def described() -> dict[str, Any]:
    """What the page is told of a run, with a text wherever one can be."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    qpos = [f"plant.qpos[{i + 1}]" for i in range(model.nq)]
    columns = ["time", *qpos, ODD]
    about = {"title": ODD, "purpose": ODD, "facts": [ODD], "notes": [ODD], "criteria": [],
             "verdict": {"state": "plain", "words": ODD}, "limits": [], "moments": [],
             "waypoints": [], "curves": [{"title": ODD, "columns": [ODD]}]}  # fmt: skip
    kinds = zip(TUNABLES, ("Real", "Boolean", "Enumeration"), ([], [], [ODD]), strict=True)
    return {
        "name": ODD, "about": about, "model": describe(model), "columns": columns,
        "signals": [{"name": ODD, "columns": [ODD], "units": [ODD], "unit": ODD, "words": ODD}],
        "roles": {"qpos": qpos}, "bounds": {}, "duration": 1.0,
        "row": [0.0, *model.qpos0.tolist(), 0.0],
        "tunables": [{"name": name, "unit": ODD, "words": ODD, "minimum": None, "maximum": None,
                      "kind": kind, "choices": choices} for name, kind, choices in kinds],
        "couplings": [ODD], "pushes": [], "plan": PLAN,
    }  # fmt: skip


def test_texts_in_the_live_page_stay_text(page: Page) -> None:
    server = LiveServer(Told(), live_page(ODD, described()))  # type: ignore[arg-type]
    page.errors.clear()
    page.requests.clear()
    with server.serving():
        page.visit(server.address, 820, 560)
        page.wait(READY)
        page.wait("document.querySelector('.pv-says').textContent.includes('1.5 s behind')")
        page.click(".pv-tick-on")
        page.wait("document.querySelector('.pv-says').textContent.includes('onerror')")
        page.click(".pv-tab:last-child")
        for part in (".pv-header", ".pv-parameters", ".pv-says", ".pv-place", ".pv-chart"):
            text = page.value(f"document.querySelector('{part}').textContent")
            assert "onerror=window.ran=1" in text, part
        assert page.value(HIDDEN) is False
        assert page.value(r"/[\p{Cc}\p{Cf}]/u.test(document.title)") is False
        assert page.value("document.querySelectorAll('img, iframe').length") == 0
        assert page.value("window.ran") is None
        assert page.errors == []
        host = urlsplit(server.address).netloc
        assert {urlsplit(address).netloc for address in page.requests} <= {host, ""}
        root = "document.documentElement"
        assert page.value(f"[{root}.scrollWidth, {root}.scrollHeight]") == [820, 560]
        assert page.value("document.querySelector('.pv-stage').clientHeight") >= 0.25 * 560


def test_clients_that_stall_do_not_delay_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """One has not asked to its end, whatever time it has; others do not say goodbye."""
    monkeypatch.setattr(server_module, "OPEN_TIME", 60.0)
    server = LiveServer(Told(), "")  # type: ignore[arg-type]
    with ExitStack() as clients:
        with server.serving():
            address = urlsplit(server.address)
            place = SimpleNamespace(host=address.netloc, token=address.query.partition("=")[2])
            for content in (b"GET / HT", upgrade(place)):  # type: ignore[arg-type]
                client = socket.create_connection((address.hostname, address.port), timeout=10)  # type: ignore[arg-type]
                clients.enter_context(client)
                client.sendall(content)
            assert client.recv(12) == b"HTTP/1.1 101"
            began = time.monotonic()
        assert time.monotonic() - began < 4 * server_module.CLOSE_TIME


class Busy:
    """Stands for a session that refuses commands and is stepped."""

    is_open, tick, ticks, held = True, 0, 1000, ()
    parameters: ClassVar[dict[str, Any]] = {}
    tunables: ClassVar[dict[str, Any]] = {}
    coupling, folder = "gauss-seidel", ""
    scenario = SimpleNamespace(step=0.001)

    def row(self) -> np.ndarray:
        """Return a row."""
        return np.zeros(3)

    def set(self, _name: str, _value: object) -> None:
        """Refuse."""
        raise InputError("no")

    def step(self, size: int) -> None:
        """Take steps."""
        self.tick += size


def test_commands_without_end_do_not_hold_up_the_steps() -> None:
    """For each command that is carried out, another one is there."""

    class SteppedError(Exception):
        """A step was taken."""

    command, asked_for = Set(do="set", name="x", value=1.0), 0

    def again(_why: str) -> None:
        nonlocal asked_for
        asked_for += 1
        assert asked_for < 10_000
        simulation.ask(command, again)

    def rows(_rows: object) -> None:
        raise SteppedError

    simulation = Simulation(Busy())  # type: ignore[arg-type]
    simulation.ask(command, again)
    with pytest.raises(SteppedError):
        simulation.run(SimpleNamespace(rows=rows, status=lambda _: None))  # type: ignore[arg-type]
