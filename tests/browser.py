"""A headless Chromium for tests, spoken to as its own developers' tools do: without a driver."""

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from bounded import running, wait_until

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--remote-debugging-port=0",
    "--webgl-antialiasing-mode=none",  # software draws here, and smooth edges are dear
    "about:blank",  # instead of the page of a new tab, which has a frame of its own
)  # fmt: skip
TIMEOUT = 60.0  # [s] for any answer, on a busy machine
SRCDOC = "about:srcdoc"  # address of a frame whose page is an attribute


def find_browser() -> str | None:
    """Return the path of a Chromium, or None."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


class Page:
    """One page in the browser.

    Attributes:
        errors: What the page has complained of since it was opened.
        requests: Addresses that it has asked for since then.
    """

    def __init__(self, line: ClientConnection) -> None:
        self._line = line
        self._count = 0
        self._session: str | None = None
        self.errors: list[str] = []
        self.requests: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Send a command and return its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        deadline = time.monotonic() + TIMEOUT  # for the answer, whatever events come before it
        self._line.send(json.dumps(message))
        while True:
            answer = json.loads(self._line.recv(max(deadline - time.monotonic(), 0.0)))
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        method, found = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(found["exceptionDetails"])[:2000])
        elif method == "Runtime.consoleAPICalled" and found["type"] in ("error", "assert"):
            self.errors.append(json.dumps(found["args"])[:2000])
        elif method == "Log.entryAdded" and found["entry"]["level"] == "error":
            self.errors.append(found["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])

    def open(self, path: Path, *size: Any, place: str = "", **how: Any) -> None:
        """Show a file as `visit` does, at a `#place` in it."""
        self.visit(path.resolve().as_uri() + place, *size, **how)

    def visit(
        self, address: str, width: int = 1280, height: int = 900, scheme: str = "light"
    ) -> None:
        """Show what is at an address."""
        self.resize(width, height)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.call("Emulation.setEmulatedMedia", features=[feature])
        # Away first: to another place in the same file there is no loading.
        self.call("Page.navigate", url="about:blank")
        self.errors.clear()
        self.requests.clear()
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'")

    def resize(self, width: int, height: int) -> None:
        """Give the window another size."""
        window = {"width": width, "height": height, "mobile": width < 700}
        # Software draws here, and a quarter of the dots is enough.
        self.call("Emulation.setDeviceMetricsOverride", deviceScaleFactor=0.5, **window)

    def value(self, expression: str) -> Any:
        """Evaluate JavaScript and return its value."""
        how = {"returnByValue": True, "awaitPromise": True}
        answer = self.call("Runtime.evaluate", expression=expression, **how)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"])[:2000])
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        deadline = time.monotonic() + TIMEOUT
        while not self.value(condition):
            if time.monotonic() > deadline:
                raise TimeoutError(f"never came true: {condition}")
            time.sleep(0.05)

    @contextmanager
    def in_frame(self) -> Iterator[None]:
        """Speak to the page's frame that the browser keeps in a process of its own."""
        deadline = time.monotonic() + TIMEOUT
        while len(frames := self._frames()) != 1:  # that of the page before may still be there
            if time.monotonic() > deadline:
                raise TimeoutError(f"the page never had one frame, but {len(frames)}")
            time.sleep(0.05)
        attached = self.call("Target.attachToTarget", targetId=frames[0], flatten=True)
        before, self._session = self._session, attached["sessionId"]
        try:
            self.wait(f"location.href === '{SRCDOC}' && document.readyState === 'complete'")
            yield
        finally:
            self._session = before

    def _frames(self) -> list[str]:
        targets = self.call("Target.getTargets")["targetInfos"]
        # The browser's own new tab has a frame, too.
        ours = [each for each in targets if (each["type"], each["url"]) == ("iframe", SRCDOC)]
        return [target["targetId"] for target in ours]

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse from one place in the window to another."""
        middle = ((start[0] + end[0]) / 2, end[1])
        for kind, place in (("mouseMoved", start), ("mousePressed", start), ("mouseMoved", middle),
                            ("mouseMoved", end), ("mouseReleased", end)):  # fmt: skip
            self._mouse(kind, *place)

    def _mouse(self, kind: str, x: float, y: float) -> None:
        pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **pressed)

    def click(self, selector: str) -> None:
        """Click with the mouse into the middle of the first element that a selector finds."""
        x, y = self.value(
            f"(b => [b.x + b.width / 2, b.y + b.height / 2])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        self.click_at(x, y)

    def click_at(self, x: float, y: float) -> None:
        """Click with the mouse."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self._mouse(kind, x, y)

    def press(self, key: str) -> None:
        """Press and release a key, named as in JavaScript's `event.key`."""
        text = {"text": key} if len(key) == 1 else {}
        code = {"Enter": 13, "Escape": 27, "ArrowDown": 40, "ArrowUp": 38, " ": 32}.get(key, 0)
        for kind in ("keyDown", "keyUp"):
            more = text if kind == "keyDown" else {}
            about = {"type": kind, "key": key, "windowsVirtualKeyCode": code, **more}
            self.call("Input.dispatchKeyEvent", **about)

    def type(self, text: str) -> None:
        """Type text into what has the focus."""
        self.call("Input.insertText", text=text)


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """Start a browser with a profile folder of its own, and give a page."""
    command = [str(find_browser()), *FLAGS, f"--user-data-dir={profile}"]
    with running(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
        place = profile / "DevToolsActivePort"  # has its port, and a path
        wait_until(lambda: place.is_file() and "/" in place.read_text())
        port, path = place.read_text().split()
        with connect(f"ws://127.0.0.1:{port}{path}", max_size=None, compression=None) as line:
            yield Page(line)
