"""A headless Chromium driven by the WebDriver protocol (W3C): pages opened, scripts run, pictures taken."""

from __future__ import annotations

import base64
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

DRIVER, BROWSER = shutil.which("chromedriver"), shutil.which("chromium") or shutil.which("google-chrome")
MISSING = "" if DRIVER and BROWSER else "no chromium and chromedriver here (Debian: chromium, chromium-driver)"
SWITCHES = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")
PATIENCE_S = 60.0


class Browser:
    """One window."""

    def __init__(self, driver: str, session: str) -> None:
        self._address = f"{driver}/session/{session}"
        self._http = httpx.Client(timeout=120.0, trust_env=False)

    def _do(self, method: str, path: str, **body: object) -> Any:
        answer = self._http.request(method, self._address + path, json=body if method == "POST" else None)
        value = answer.json()["value"]
        assert answer.is_success, value
        return value

    def open(self, address: str) -> None:
        """Load a page."""
        self._do("POST", "/url", url=address)

    def run(self, script: str, *args: object) -> Any:
        """Return what a script returns."""
        return self._do("POST", "/execute/sync", script=script, args=list(args))

    def until(self, script: str) -> Any:
        """Wait until a script returns something true."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            if found := self.run(f"return {script}"):
                return found
            time.sleep(0.1)
        raise AssertionError(f"never true: {script}")

    def keys(self, text: str) -> None:
        """Type at whatever has the focus."""
        actions = [
            step for char in text for step in ({"type": "keyDown", "value": char}, {"type": "keyUp", "value": char})
        ]
        self._do("POST", "/actions", actions=[{"type": "key", "id": "keyboard", "actions": actions}])

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Give the page a size, as a phone would if asked for."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        self.devtools("Emulation.setDeviceMetricsOverride", **metrics)

    def dark(self, *, on: bool) -> None:
        """Say whether the reader prefers dark pages."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if on else "light"}]
        self.devtools("Emulation.setEmulatedMedia", features=features)

    def devtools(self, command: str, **params: object) -> Any:
        """Give Chromium an order of its own protocol."""
        return self._do("POST", "/goog/cdp/execute", cmd=command, params=params)

    def picture(self, path: Path) -> None:
        """Write what the window shows as PNG."""
        path.write_bytes(base64.b64decode(self._do("GET", "/screenshot")))

    def close(self) -> None:
        """Close the window."""
        self._do("DELETE", "")


@contextmanager
def browser() -> Iterator[Browser]:
    """Open a window; its driver and Chromium end with it."""
    assert DRIVER
    assert BROWSER
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([DRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}"
    try:
        _wait(address)
        options = {"goog:chromeOptions": {"binary": BROWSER, "args": list(SWITCHES)}}
        answer = httpx.post(
            f"{address}/session", json={"capabilities": {"alwaysMatch": options}}, timeout=120.0, trust_env=False
        ).json()["value"]
        assert "sessionId" in answer, answer
        window = Browser(address, answer["sessionId"])
        try:
            yield window
        finally:
            window.close()
    finally:
        process.terminate()
        process.wait(10)


def _wait(address: str) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        try:
            if httpx.get(f"{address}/status", trust_env=False).json()["value"]["ready"]:
                return
        except httpx.TransportError:
            time.sleep(0.1)
    raise AssertionError("chromedriver does not answer")
