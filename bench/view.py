"""`view.*`: what the page of several robots costs its server, while a browser looks at robots that wave."""

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.daemon import BenchDaemon, scratch, twind
from bench.harness import (
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of,
    interleaved,
    medians,
    spread,
)
from twind.client import ClientError
from twind.command_line.trajectory_files import load_motion

# windows, s of each, s until a page shows what it will go on showing
ROUNDS = 5
SPAN = 4.0
SETTLED = 3.0
COUNTS = (1, 4, 8)  # robots on the page
PROGRAM = """import sys
from twind.observe.viewing.fleet import watch
from twind.observe.viewing.robot_connections import local
robots = {(f"robot{n}", "here"): local(sys.argv[1]) for n in range(int(sys.argv[2]))}
sys.exit(watch(lambda: robots))"""
# A page draws thrice a second: without a graphics card it would take the processor that is measured.
SELDOM = "const f = requestAnimationFrame; window.requestAnimationFrame = g => setTimeout(() => f(g), 300)"
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def take() -> Mapping[str, MeasuredFigure]:
    """One viewer for each count, each with a page of one browser; measured in turns."""
    with scratch() as folder, twind(folder, "--mode", "sim") as daemon, ExitStack() as stack:
        opened = stack.enter_context(_browser())
        viewers = {count: stack.enter_context(_viewer(folder, count)) for count in COUNTS}
        stack.enter_context(_waving(daemon))
        alone = interleaved(
            ROUNDS, {str(count): partial(_share, viewer[0]) for count, viewer in viewers.items()}
        )
        looked = interleaved(
            ROUNDS, {str(count): partial(_looked_at, opened, viewer) for count, viewer in viewers.items()}
        )
    found = medians(looked)
    without = medians(alone)
    return {
        f"view.robots_{count}": MeasuredFigure(
            found[str(count)],
            f"{count} robots of 24 joints that wave, each a connection of its own to one daemon in sim, 10 "
            f"pictures/s; {spread(looked[str(count)], '%')}; {without[str(count)]:.2f} while nobody looks",
        )
        for count in COUNTS
    }


def _share(pid: int) -> float:
    """% of a core."""
    before = cpu_of(pid)
    since = time.monotonic()
    time.sleep(SPAN)
    return (cpu_of(pid) - before) / (time.monotonic() - since) * 100.0


def _looked_at(browser: Any, viewer: tuple[int, str]) -> float:
    page = browser.new_page(viewport={"width": 1280, "height": 800}, device_scale_factor=0.2)
    try:
        page.add_init_script(SELDOM)
        page.goto(viewer[1])
        page.get_by_text("24 of 24 heard").first.wait_for(timeout=60_000)
        time.sleep(SETTLED)
        return _share(viewer[0])
    finally:
        page.close()


@contextmanager
def _viewer(folder: Path, count: int) -> Iterator[tuple[int, str]]:
    """Its process and address."""
    command = [sys.executable, "-c", PROGRAM, str(folder), str(count)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        words = process.stdout.readline().split()
        if not words:
            raise MeasurementUnavailable("the viewer did not start")
        yield process.pid, words[-1]
    finally:
        process.terminate()
        process.wait(20.0)
        process.stdout.close()


@contextmanager
def _waving(daemon: BenchDaemon) -> Iterator[None]:
    """The robot waves again and again. What a busy machine ends begins anew."""
    ended = threading.Event()

    def wave() -> None:
        while not ended.is_set():
            with suppress(ClientError), daemon.client() as client:
                client.call("AcquireLease")
                for _ in client.stream("SubmitTrajectory", trajectory=load_motion("wave")):
                    if ended.is_set():
                        return
            ended.wait(0.1)

    thread = threading.Thread(target=wave)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def _browser() -> Iterator[Any]:
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    missing = [name for name in ("viser", "mjviser", "playwright") if find_spec(name) is None]
    if missing or path is None:
        raise MeasurementUnavailable(f"not here: {', '.join(missing) or 'Chromium'}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        found = play.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield found
        finally:
            found.close()


MEASUREMENTS = (Measurement({f"view.robots_{count}": FigureSpec("% of a core") for count in COUNTS}, take),)
