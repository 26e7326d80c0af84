"""Headless Chromium on the viewer's page: what tests look at, and pictures for the docs.

`python tests/support/browser.py URL FILE.png [WIDTH HEIGHT]` takes one picture of a viewer that runs.
"""

import contextlib
import io
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
]
SIZE = (1280, 800)
MIDDLE = {"x": 350, "y": 160, "width": 600, "height": 500}  # of that page: what no panel covers
SELDOM = """
const f = requestAnimationFrame;
window.requestAnimationFrame = g => setTimeout(() => f(g), 300);
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"])
  WebGL2RenderingContext.prototype[name] = () => {};
"""
CELL = 5  # pixels of a cell's side
SETTLED = 15.0  # s until the page shows what it was told


def missing() -> str:
    """Why no page can be looked at here, or nothing. Imports nothing: whoever reads the tests asks it."""
    for library in ("mjviser", "playwright"):
        if find_spec(library) is None:
            return f"{library} is not installed"
    return "" if chromium() else "no Chromium on this machine"


def chromium() -> str | None:
    """Path of the browser."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """A browser with a new, empty profile."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play, tempfile.TemporaryDirectory(prefix="twind-browser-") as folder:
        found = play.chromium.launch(executable_path=chromium(), args=FLAGS, env={"HOME": folder})
        try:
            yield found
        finally:
            found.close()


def opened(
    found: Any,
    url: str,
    size: tuple[int, int] = SIZE,
    *,
    looked_at: bool = True,
    shows: str = "last 10 s",
) -> Any:
    """The page, once it shows its panels, or these words. `page.asked`: the address of every request.

    Where it is not `looked_at` it draws nothing, thrice a second: a robot beside it needs the processor.
    """
    sharp = 1.0 if looked_at else 0.2
    page = found.new_page(viewport={"width": size[0], "height": size[1]}, device_scale_factor=sharp)
    if not looked_at:
        page.add_init_script(SELDOM)
    page.asked = []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("websocket", lambda socket: page.asked.append(socket.url))
    page.goto(url)
    page.get_by_text(shows).wait_for(timeout=60_000)
    return page


def picture(page: Any, clip: dict[str, int] | None = None) -> Any:
    """Middle of the page, once two looks at it are the same: the mean of cells (h, w, 3).

    Cells, not pixels: the page lowers its own resolution where the machine is slow.
    """
    from PIL import Image

    def look() -> Any:
        data = page.screenshot(clip=clip or MIDDLE, timeout=90_000)
        pixels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(np.float64)
        rows = pixels.shape[0] // CELL
        columns = pixels.shape[1] // CELL
        cells = pixels[: rows * CELL, : columns * CELL].reshape(rows, CELL, columns, CELL, 3)
        return cells.mean(axis=(1, 3))

    page.wait_for_timeout(400)
    before = look()
    deadline = time.monotonic() + SETTLED
    while time.monotonic() < deadline:
        page.wait_for_timeout(150)
        now = look()
        if changed(before, now).sum() < 4:
            return now
        before = now
    return before


def changed(one: Any, other: Any, by: float = 20.0) -> Any:
    """(h, w) bool: cells that differ by more than so many of 255 in a colour."""
    return (np.abs(one - other) > by).any(axis=2)


def photograph(url: str, path: str | Path, size: tuple[int, int] = SIZE, seconds: float = 3.0) -> None:
    """The page at `url` as a PNG, after it was looked at for so long."""
    with browser() as found:
        page = opened(found, url, size)
        page.add_style_tag(content=".mantine-Notifications-root {display: none}")  # that WebGL is software
        page.wait_for_timeout(seconds * 1e3)
        page.screenshot(path=str(path))


if __name__ == "__main__":
    wide = (int(sys.argv[3]), int(sys.argv[4])) if len(sys.argv) > 4 else SIZE
    photograph(sys.argv[1], sys.argv[2], wide)
