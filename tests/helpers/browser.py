# SPDX-License-Identifier: GPL-3.0-or-later
"""Chromium driven through chromedriver's HTTP interface (W3C WebDriver), with nothing but the standard library."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")

_ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
_SECONDS = 60.0


class Browser:
    """One headless window with a profile of its own.

    Parameters
    ----------
    profile : folder that is fresh and goes with the test
    """

    def __init__(self, profile: Path, size: tuple[int, int] = (1200, 1000)) -> None:
        assert CHROMIUM is not None and CHROMEDRIVER is not None
        # A proxy has no business between two processes of this machine.
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._driver = subprocess.Popen([CHROMEDRIVER, "--port=0"], stdout=subprocess.PIPE, text=True)
        try:
            self._base = f"http://127.0.0.1:{self._port()}"
            arguments = [
                "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                "--disable-dev-shm-usage", f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}",
            ]  # fmt: skip
            options = {"binary": CHROMIUM, "args": arguments}
            asked = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
            answer = self._send("POST", "/session", {"capabilities": {"alwaysMatch": asked}})
            self._base += f"/session/{answer['sessionId']}"
        except BaseException:
            self._end_driver()
            raise

    def _port(self) -> int:
        assert self._driver.stdout is not None
        for line in self._driver.stdout:
            found = re.search(r"started successfully on port (\d+)", line)
            if found:
                return int(found[1])
        raise RuntimeError("chromedriver ended before it listened")

    def _send(self, method: str, path: str, body: Any = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._base + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with self._opener.open(request, timeout=_SECONDS) as answer:
                return json.loads(answer.read())["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(error.read().decode()) from error

    def _end_driver(self) -> None:
        self._driver.terminate()
        self._driver.wait(10.0)
        if self._driver.stdout is not None:
            self._driver.stdout.close()

    def close(self) -> None:
        """Close window and driver."""
        try:
            self._send("DELETE", "")
        finally:
            self._end_driver()

    def open(self, address: str) -> None:
        """Load a page and wait for it."""
        self._send("POST", "/url", {"url": address})

    def run(self, script: str, *arguments: Any) -> Any:
        """What JavaScript returns."""
        return self._send("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def find(self, selector: str) -> Any:
        """The first element by a CSS selector, to be given to `run` and `click`."""
        return self._send("POST", "/element", {"using": "css selector", "value": selector})

    def click(self, selector: str) -> None:
        """A click as from a mouse."""
        self._send("POST", f"/element/{self.find(selector)[_ELEMENT]}/click", {})

    def press(self, selector: str, keys: str) -> None:
        """Type into an element that has the focus or gets it."""
        self._send("POST", f"/element/{self.find(selector)[_ELEMENT]}/value", {"text": keys})

    def wheel(self, x: int, y: int, delta_y: int) -> None:
        """Turn the wheel over a point of the window [CSS pixels]; negative is away from the user."""
        turn = {"type": "scroll", "x": x, "y": y, "deltaX": 0, "deltaY": delta_y, "duration": 0, "origin": "viewport"}
        self._send("POST", "/actions", {"actions": [{"type": "wheel", "id": "wheel", "actions": [turn]}]})

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        """Press, move and release the left button."""
        steps = [
            {"type": "pointerMove", "duration": 0, "x": start[0], "y": start[1], "origin": "viewport"},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerMove", "duration": 50, "x": end[0], "y": end[1], "origin": "viewport"},
            {"type": "pointerUp", "button": 0},
        ]
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps}
        self._send("POST", "/actions", {"actions": [mouse]})

    def emulate(self, feature: str, value: str) -> None:
        """A media feature, such as `prefers-color-scheme`."""
        parameters = {"features": [{"name": feature, "value": value}]}
        self._send("POST", "/goog/cdp/execute", {"cmd": "Emulation.setEmulatedMedia", "params": parameters})

    def complaints(self) -> list[str]:
        """Errors and warnings of the page since the last call."""
        return [entry["message"] for entry in self._send("POST", "/se/log", {"type": "browser"})]

    def screenshot(self, path: Path) -> None:
        """The window as PNG."""
        path.write_bytes(base64.b64decode(self._send("GET", "/screenshot")))
