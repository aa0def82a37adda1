"""Headless Chromium, driven by its DevTools protocol; WebGL runs in software."""

import base64
import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np
from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--remote-debugging-port=0",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--disable-sync",
)
PANELS_WITHOUT_WEBGL = "--disable-gpu-compositing"
"""Panels would be drawn by WebGL in software, too, which is slower where no scene is drawn."""
START_TIMEOUT_S = 30.0
WIDTH, HEIGHT = 1280, 800
DEVTOOLS = "DevTools listening on "

UNTIL = """
new Promise((resolve, reject) => {
  const end = performance.now() + %f * 1000;
  const look = () => {
    let found = false;
    try { found = (%s); } catch (error) { /* not there yet */ }
    if (found) resolve(found);
    else if (performance.now() > end) reject(new Error("never came true"));
    else setTimeout(look, 50);
  };
  look();
})
"""
PIXELS = """
(() => {
  const seen = window.__viserMutable.canvas, copy = document.createElement("canvas");
  [copy.width, copy.height] = [seen.width, seen.height];
  const context = copy.getContext("2d");
  context.drawImage(seen, 0, 0);
  const bytes = context.getImageData(0, 0, copy.width, copy.height).data;
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) {
    text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  }
  return [copy.width, copy.height, btoa(text)];
})()
"""


class Tab:
    """One page in the browser."""

    def __init__(self, connection: ClientConnection, session: str) -> None:
        self._connection = connection
        self._session = session
        self._number = 0
        self.complaints: list[str] = []
        """Console errors of the page, including content policy violations."""

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        call = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            call["sessionId"] = self._session
        self._connection.send(json.dumps(call))
        while True:
            message = json.loads(self._connection.recv(timeout=150.0))
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                return dict(message["result"])
            self._note(message)

    def open(self, url: str, query: str = "?fixedDpr=1") -> None:
        """Open a viewer page, by itself at full resolution, also on slow machines."""
        self.call("Log.enable")
        self.call("Runtime.enable")
        self.set_size(WIDTH, HEIGHT)
        deleted = self.call("Page.navigate", url=f"{url}/{query}")
        if deleted.get("errorText"):
            raise ConnectionError(f"{url}: {deleted['errorText']}; is the page served there?")

    def set_size(self, width: int, height: int, *, is_mobile: bool = False) -> None:
        """Set the size of the window [px]."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": is_mobile}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def set_touch(self, *, is_on: bool) -> None:
        """Choose whether a finger is the pointer."""
        self.call("Emulation.setTouchEmulationEnabled", enabled=is_on)

    def evaluate(self, expression: str) -> Any:  # noqa: ANN401  it is JSON
        """Return the value of an expression; awaits a promise."""
        done = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in done:
            raise RuntimeError(f"{expression.strip()[:200]}: {done['exceptionDetails']}")
        return done["result"].get("value")

    def until(self, expression: str, within_s: float = 30.0) -> Any:  # noqa: ANN401
        """Wait until an expression is true; return it."""
        return self.evaluate(UNTIL % (within_s, expression))

    def point(self, x: float, y: float) -> None:
        """Move the pointer to a position."""
        self._mouse("mouseMoved", x, y)

    def click(self, x: float, y: float, *, modifiers: int = 0) -> None:
        """Click the left button at a position; modifiers as in the protocol, 8 is shift."""
        self.point(x, y)
        left: dict[str, object] = {"button": "left", "clickCount": 1, "modifiers": modifiers}
        self._mouse("mousePressed", x, y, **left)
        self._mouse("mouseReleased", x, y, **left)

    def touch(self, x: float, y: float) -> None:
        """Tap a position with a finger."""
        self.call("Emulation.setTouchEmulationEnabled", enabled=True)
        self.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.call("Emulation.setTouchEmulationEnabled", enabled=False)

    def press(self, label: str) -> None:
        """Click the visible button with this text."""
        labelled = (
            "[...document.querySelectorAll('button')]"
            f".find(b => b.innerText === '{label}' && b.checkVisibility())"
        )
        self.until(f"!!{labelled}")
        self.evaluate(f"{labelled}.click()")

    def turn_to(self, title: str) -> None:
        """Turn to the tab with this title in a panel."""
        place = (
            f"(() => {{ const box = document.querySelector('[role=tab][title=\"{title}\"]')"
            ".getBoundingClientRect(); return box.width && [box.x + box.width / 2,"
            " box.y + box.height / 2]; })()"
        )
        self.click(*self.until(place))

    def pixels(self) -> np.ndarray:
        """Return the 3D picture, (height, width, 3) of uint8."""
        width, height, text = self.evaluate(PIXELS)
        flat = np.frombuffer(base64.b64decode(text), dtype=np.uint8)
        return flat.reshape(height, width, 4)[:, :, :3]

    def screenshot(self) -> bytes:
        """Return the whole page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def _note(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(str(message["params"]["exceptionDetails"]))
        entry = message.get("params", {}).get("entry", {})
        if entry.get("level") == "error":
            self.complaints.append(f"{entry['text']} {entry.get('url', '')}")


class Chromium:
    """A separate browser process; close it after use."""

    def __init__(self, *flags: str) -> None:
        program = next((found for name in NAMES if (found := shutil.which(name))), None)
        if program is None:
            raise FileNotFoundError("no Chromium found; apt-get install chromium")
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            [program, *FLAGS, *flags, f"--user-data-dir={self._profile.name}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            self._connection = connect(self._endpoint(), max_size=None, compression=None)
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> "Chromium":
        """Return the browser itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the browser."""
        self.close()

    def tab(self) -> Tab:
        """Open an empty page; use one at a time."""
        browser = Tab(self._connection, "")
        target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        session = browser.call("Target.attachToTarget", targetId=target, flatten=True)
        return Tab(self._connection, session["sessionId"])

    def close(self) -> None:
        """Close the connection, end the browser and delete its profile."""
        self._connection.close()
        self._end()

    def _end(self) -> None:
        self._process.terminate()
        self._process.wait(timeout=10.0)
        if self._process.stderr is not None:
            self._process.stderr.close()
        self._profile.cleanup()

    def _endpoint(self) -> str:
        if self._process.stderr is None:
            raise RuntimeError("the browser has no standard error to read")
        for line in self._process.stderr:
            if DEVTOOLS in line:
                return line.split(DEVTOOLS)[1].strip()
        raise RuntimeError("Chromium ended before it could be driven")


@contextmanager
def open_page(url: str) -> Iterator[Tab]:
    """Open a viewer page in a separate browser."""
    with Chromium() as browser:
        tab = browser.tab()
        tab.open(url)
        yield tab
