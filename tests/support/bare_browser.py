"""Headless Chromium by its own protocol: with Playwright every tab counts as visible, here one can hide."""

import itertools
import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from tests.support.browser import FLAGS, SELDOM, chromium
from tests.support.processes import favour, until

LISTENING = "DevTools listening on "


class BareTab:
    """The first tab of a browser, and the browser's process group."""

    def __init__(self, process: "subprocess.Popen[str]", address: str) -> None:
        from websockets.sync.client import connect

        self._process = process
        self._line = connect(address, max_size=None)
        self._numbers = itertools.count(1)
        self._session: str | None = None
        self._target = next(
            each["targetId"]
            for each in self._call("Target.getTargets")["targetInfos"]
            if each["type"] == "page"
        )
        attached = self._call("Target.attachToTarget", targetId=self._target, flatten=True)
        self._session = attached["sessionId"]
        self._call("Page.enable")
        self._call("Page.addScriptToEvaluateOnNewDocument", source=SELDOM)

    def _call(self, method: str, **parameters: Any) -> Any:
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None and not method.startswith("Target."):
            message["sessionId"] = self._session
        self._line.send(json.dumps(message))
        while (answer := json.loads(self._line.recv())).get("id") != number:
            pass
        return answer.get("result", answer)

    def open(self, url: str) -> None:
        """Go there; the page may not be complete yet."""
        self._call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        return self._call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get(
            "value"
        )

    def click(self, text: str) -> None:
        """Click the button with this text, as an event."""
        buttons = "[...document.querySelectorAll('button')]"
        found = f"{buttons}.find(each => each.innerText === {json.dumps(text)} && !each.disabled)"
        until(lambda: self.value(f"!!{found}"), 60.0, f"the button {text}")
        self.value(f"{found}.click()")

    def pointer(self, kind: str, x: float, y: float) -> None:
        """`mouseMoved`, `mousePressed` or `mouseReleased`, as from a real mouse."""
        self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def hide(self) -> None:
        """Open another tab in front of this one."""
        self._call("Target.createTarget", url="about:blank")

    def show(self) -> None:
        """Bring this tab to the front."""
        self._call("Target.activateTarget", targetId=self._target)

    def close(self) -> None:
        """Close the tab; the browser goes on."""
        self._call("Target.closeTarget", targetId=self._target)

    def signal(self, number: int) -> None:
        """Send a signal to all processes of the browser."""
        os.killpg(self._process.pid, number)

    def disconnect(self) -> None:
        """End this connection to the browser."""
        self._line.close()


@contextmanager
def bare_browser() -> Iterator[BareTab]:
    """A browser with a new, empty profile and one tab."""
    with tempfile.TemporaryDirectory(prefix="twind-browser-", ignore_cleanup_errors=True) as home:
        options = [
            *FLAGS,
            "--window-size=1280,800",
            "--remote-debugging-port=0",
            f"--user-data-dir={home}/profile",
            "about:blank",
        ]
        with subprocess.Popen(
            [str(chromium()), *options],
            env={"HOME": home, "PATH": os.environ["PATH"]},
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            favour(process)
            assert process.stderr is not None
            line = next(line for line in process.stderr if line.startswith(LISTENING))
            tab = BareTab(process, line.removeprefix(LISTENING).strip())
            try:
                yield tab
            finally:
                tab.disconnect()
                for number in (signal.SIGCONT, signal.SIGKILL):
                    with suppress(ProcessLookupError):
                        tab.signal(number)
                time.sleep(0.1)
