"""A headless Chromium, driven by its DevTools protocol: enough to look at a page, and to drag on it."""

import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: Seconds until the browser must be up, or an answer there.
PATIENCE = 60.0


class Browser:
    """One tab; `errors` are console errors and exceptions, `requests` all that is not the page's file or within it."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._number = 0
        self._loaded = False
        self._session: str | None = None
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; events that come before it are noted."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        self.socket.send(json.dumps({**message, "sessionId": self._session} if self._session else message))
        while True:
            got = json.loads(self.socket.recv(timeout=PATIENCE))
            if got.get("id") == self._number:
                assert "error" not in got, got
                return got["result"]
            self._note(got.get("method"), got.get("params", {}))

    def _note(self, event: str | None, details: dict[str, Any]) -> None:
        if event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(details["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and details["type"] in ("error", "warning", "assert"):
            self.errors.append(json.dumps(details["args"]))
        elif event == "Log.entryAdded" and details["entry"]["level"] in ("error", "warning"):
            self.errors.append(details["entry"]["text"])
        elif event == "Network.requestWillBeSent" and not details["request"]["url"].startswith(
            ("file:", "data:")
        ):
            self.requests.append(details["request"]["url"])
        elif event == "Page.loadEventFired":
            self._loaded = True

    def open(self, file: Path) -> None:
        self._loaded = False
        self.send("Page.navigate", url=file.as_uri())
        end = time.monotonic() + PATIENCE
        while not self._loaded:
            assert time.monotonic() < end, "the page does not load"
            self.evaluate("0")

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, as JSON has it."""
        found = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def choose(self, select: str, text: str) -> None:
        """As a reader would: an option of a <select>, with the event that follows."""
        self.evaluate(
            f"(() => {{ const s = document.querySelector({json.dumps(select)}); "
            f"const o = [...s.options].find((o) => o.text === {json.dumps(text)}); "
            "s.value = o.value; s.dispatchEvent(new Event('change')); })()"
        )

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """x, y, width, height within the window; what is elsewhere on the page is scrolled to."""
        return tuple(
            self.evaluate(
                f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
                " e.scrollIntoView({block: 'center'});"
                " const b = e.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()"
            )
        )

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        middle = ((start[0] + end[0]) / 2.0, (start[1] + end[1]) / 2.0)
        for point in (middle, end):
            self.mouse("mouseMoved", *point, button="left", buttons=1)
        self.mouse("mouseReleased", *end, button="left", buttons=0, clickCount=1)

    def click(self, selector: str) -> None:
        x, y, width, height = self.box(selector)
        self.drag(*[(x + width / 2.0, y + height / 2.0)] * 2)

    def pixels(self, selector: str) -> np.ndarray:
        """What is seen of an element: RGB, int."""
        x, y, width, height = self.box(selector)
        left, top = self.evaluate("[window.scrollX, window.scrollY]")
        clip = {"x": x + left, "y": y + top, "width": width, "height": height, "scale": 1}
        shot = self.send("Page.captureScreenshot", clip=clip)
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")).astype(int)


def start(program: str, profile: Path) -> subprocess.Popen:
    flags = ["--headless=new", "--disable-gpu", "--no-first-run", "--hide-scrollbars"]
    flags += ["--remote-debugging-port=0", f"--user-data-dir={profile}", "--window-size=1300,1000"]
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # Chromium refuses to sandbox itself as root
    command = [program, *flags, "about:blank"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def address(process: subprocess.Popen, profile: Path) -> str:
    """Of the DevTools, which the browser writes into its profile once it is up."""
    file, end = profile / "DevToolsActivePort", time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        if file.exists() and len(lines := file.read_text().split()) == 2:
            return "ws://127.0.0.1:{}{}".format(*lines)
        time.sleep(0.05)
    pytest.fail("Chromium did not start")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    client = pytest.importorskip(
        "websockets.sync.client", reason="websockets, to talk to a browser, is missing"
    )
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip(f"no Chromium is installed (looked for {', '.join(NAMES)})")
    profile = tmp_path_factory.mktemp("profile")
    process = start(program, profile)
    try:
        with client.connect(address(process, profile), max_size=None) as socket:
            yield Browser(socket)
    finally:
        process.terminate()
        process.wait(PATIENCE)
