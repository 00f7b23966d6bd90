"""A headless Chromium, driven over its debugging pipe; what a test needs of it and no more."""

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

FLAGS = (
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage", "--no-proxy-server",
)  # fmt: skip
NO_GPU, WEBGL = ("--disable-gpu",), ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Without a GPU's emulation a page takes half the processor time, and has no WebGL."""


ALT, CTRL, SHIFT = 1, 2, 8
CODES = {"Enter": 13, "Escape": 27, "Delete": 46, "PageUp": 33, "PageDown": 34, "Tab": 9, " ": 32}
CODES |= {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Home": 36, "End": 35}
CODES |= {".": 190, ",": 188, "-": 189}


def browser() -> str | None:
    """Path of a Chromium, if there is one."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return next((found for name in names if (found := shutil.which(name))), None)


class Navigated(AssertionError):
    """The page that was asked was just left for another one."""


class Tab:
    """One page of a browser of its own.

    ``requests`` are the addresses that were asked for, ``complaints`` what reached the console or was thrown,
    ``questions`` kinds of dialogs, as "beforeunload", which are answered with ``answer``.
    """

    def __init__(self, profile: Path, width: int = 1280, height: int = 800, flags: tuple[str, ...] = NO_GPU) -> None:
        to_browser, to_us = os.pipe(), os.pipe()
        # The browser reads file descriptor 3 and writes 4; they are moved there in a shell, after the fork.
        script = f'exec "$@" 3<&{to_browser[0]} 4>&{to_us[1]}'
        own = (f"--user-data-dir={profile}", "--remote-debugging-pipe", "about:blank")
        command = [str(browser()), *FLAGS, *flags, *own]
        self.process = subprocess.Popen(
            ["bash", "-c", script, "browser", *command],
            pass_fds=(to_browser[0], to_us[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser[0])
        os.close(to_us[1])
        self.reader, self.writer = to_us[0], to_browser[1]
        self.buffer = b""
        self.count = 0
        self.session: str | None = None
        self.loaded = False
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self.questions: list[str] = []
        self.answer = True
        target = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.size(width, height)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.reader)
        os.close(self.writer)

    def __enter__(self) -> Tab:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(self, method: str, **parameters: Any) -> Any:
        self.count += 1
        message: dict[str, Any] = {"id": self.count, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.writer, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next(60.0)
            if answer.get("id") == self.count:
                if "error" in answer:
                    gone = "navigated" in answer["error"].get("message", "")
                    raise (Navigated if gone else AssertionError)(f"{method}: {answer['error']}")
                return answer["result"]

    def size(self, width: int, height: int) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def theme(self, name: str) -> None:
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def open(self, page: Path) -> None:
        self.loaded = False
        self.call("Page.navigate", url=page.as_uri())
        self.wait(lambda: self.loaded)

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression, promises awaited."""
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def until(self, script: str, seconds: float = 30.0) -> None:
        """Wait until a JavaScript expression holds, on the page that comes next if this one is just left."""

        def holds() -> bool:
            try:
                return bool(self.run(script))
            except Navigated:
                return False

        self.wait(holds, seconds, script)

    def wait(self, condition: Any, seconds: float = 30.0, what: str = "page loaded") -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"not within {seconds} s: {what}; {self.complaints}"
            if select.select([self.reader], [], [], 0.05)[0] or b"\0" in self.buffer:
                self._next(1.0)

    def settle(self) -> None:
        """Until what was asked for has been drawn."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def press(self, key: str, times: int = 1, modifiers: int = 0) -> None:
        """Press a key by its name, or a character; ``modifiers`` of ``ALT``, ``CTRL`` and ``SHIFT``."""
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        told = {"key": key, "code": key, "windowsVirtualKeyCode": CODES.get(key) or ord(key.upper())}
        if text and modifiers in (0, SHIFT):
            told["text"] = text
        for _ in range(times):
            kind = "keyDown" if "text" in told else "rawKeyDown"
            self.call("Input.dispatchKeyEvent", type=kind, modifiers=modifiers, **told)
            self.call("Input.dispatchKeyEvent", type="keyUp", modifiers=modifiers, **{**told, "text": ""})

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the mouse at one place of the window, let go at another."""
        middle = tuple(0.5 * (a + b) for a, b in zip(start, end))
        for kind, place in (("Pressed", start), ("Moved", middle), ("Moved", end), ("Released", end)):
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=place[0], y=place[1], **held)

    def drop(self, place: tuple[float, float], paths: list[Path]) -> None:
        """Let go of files and folders, as a file manager's, at a place of the window."""
        data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.call("Input.dispatchDragEvent", type=kind, x=place[0], y=place[1], data=data)

    def wheel(self, place: tuple[float, float], down: float) -> None:
        """Turn the wheel over a place of the window."""
        self.call("Input.dispatchMouseEvent", type="mouseWheel", x=place[0], y=place[1], deltaX=0.0, deltaY=down)

    def picture(self, whole: bool = False) -> bytes:
        """The window, or the whole page, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def pdf(self, paper: str = "a4") -> bytes:
        """The page as it is printed, on "a4" or "letter"."""
        width, height = {"a4": (8.27, 11.69), "letter": (8.5, 11.0)}[paper]
        asked = {"paperWidth": width, "paperHeight": height, "printBackground": False, "preferCSSPageSize": False}
        return base64.b64decode(self.call("Page.printToPDF", **asked)["data"])

    def _next(self, seconds: float) -> dict[str, Any]:
        while b"\0" not in self.buffer:
            assert select.select([self.reader], [], [], seconds)[0], "the browser does not answer"
            read = os.read(self.reader, 1 << 20)
            assert read, "the browser has ended"
            self.buffer += read
        text, self.buffer = self.buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method", ""), message.get("params", {}))
        return message

    def _note(self, event: str, found: dict[str, Any]) -> None:
        if event == "Page.loadEventFired":
            self.loaded = True
        elif event == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(str(found["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and found["type"] in ("error", "warning"):
            self.complaints.append(" ".join(str(argument.get("value")) for argument in found["args"]))
        elif event == "Page.javascriptDialogOpening":
            self.questions.append(found["type"])
            told = {"id": 0, "method": "Page.handleJavaScriptDialog", "params": {"accept": self.answer}}
            os.write(self.writer, json.dumps({**told, "sessionId": self.session}).encode() + b"\0")
        elif event == "Log.entryAdded":
            self.complaints.append(" ".join((found["entry"]["text"], found["entry"].get("url", ""))).strip())
