"""Chromium, asked through its pipe: a page that talks to a server is looked at as it runs."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
DRAWING = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist")
WRONG = ("Runtime.exceptionThrown", "Log.entryAdded")


class Chromium:
    """One tab; ``with Chromium(folder) as tab``, which draws in WebGL too if ``drawing`` is set."""

    def __init__(
        self, folder: Path, width: int = 1400, height: int = 900, drawing: bool = False
    ) -> None:
        self.folder, self.width, self.height = folder, width, height
        self.drawing = DRAWING if drawing else ("--disable-gpu",)
        self.events: list[dict[str, Any]] = []
        self.session: str | None = None
        self._number, self._read = 0, b""

    def __enter__(self) -> Chromium:
        for_it, self._to = os.pipe()
        self._from, from_it = os.pipe()
        ask = f'exec "$0" "$@" 3<&{for_it} 4>&{from_it}'
        options = ["--headless=new", "--no-sandbox", "--remote-debugging-pipe", *self.drawing]
        options += [f"--user-data-dir={self.folder}"]
        self._process = subprocess.Popen(
            ["bash", "-c", ask, str(CHROMIUM), *options],
            pass_fds=(for_it, from_it),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(for_it)
        os.close(from_it)
        target = self.tell("Target.createTarget", url="about:blank")["targetId"]
        attached = self.tell("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for part in ("Page", "Runtime", "Log"):
            self.tell(f"{part}.enable")
        self.size(self.width, self.height)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(20)
        os.close(self._to)
        os.close(self._from)

    @property
    def errors(self) -> list[str]:
        """What the console was told of."""
        said = [event for event in self.events if event["method"] in WRONG]
        said += [e for e in self.events if e.get("params", {}).get("type") in ("error", "warning")]
        return [json.dumps(event)[:400] for event in said]

    def size(self, width: int, height: int) -> None:
        """Of the screen, CSS pixels."""
        how = {"deviceScaleFactor": 1, "mobile": False}
        self.tell("Emulation.setDeviceMetricsOverride", width=width, height=height, **how)

    def open(self, address: str) -> None:
        """Go to a page."""
        self.tell("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """What the body of an async function returns there."""
        asked = {"awaitPromise": True, "returnByValue": True}
        answer = self.tell("Runtime.evaluate", expression=f"(async()=>{{{script}}})()", **asked)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, condition: str, seconds: float = 500) -> None:
        """Wait until an expression is true there, on a busy machine too."""
        end = time.monotonic() + seconds
        while not self.run(f"return Boolean({condition})"):
            assert time.monotonic() < end, condition
            time.sleep(0.1)

    def picture(self, path: Path, whole: bool = False) -> None:
        """Write what is seen, or all of the page."""
        told = self.tell("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(told["data"]))

    def tell(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the DevTools protocol, and its answer."""
        self._number += 1
        asked = {"id": self._number, "method": method, "params": params}
        if self.session:
            asked["sessionId"] = self.session
        os.write(self._to, json.dumps(asked).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer)
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._read:
            assert select.select([self._from], [], [], 100)[0], "Chromium says nothing"
            self._read += os.read(self._from, 1 << 20)
        one, _, self._read = self._read.partition(b"\0")
        return json.loads(one)
