"""`make pictures`: the pictures of docs/observe.md, of a real daemon that moves a virtual robot.

Writes docs/pictures/view.png (Chromium looks at the page), monitor.svg (what the terminal shows) and plot.png
(of the recording that was made meanwhile).
"""

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from PIL import Image

from tests.support.browser import SIZE, browser, missing, opened
from tests.support.picture_drawing import svg
from tests.support.processes import Daemon, arm, daemon, go, robot, until
from twind.client import Client, ClientError, Refused
from twind.command_line.trajectory_files import load_motion
from twind.ctl.dashboard.live_dashboard import MonitorFeed

FOLDER = Path(__file__).parents[2] / "docs" / "pictures"
MOST = 300_000  # bytes of one picture
COLOURS = 128  # of a PNG: enough for what is drawn, a third of the bytes
UP = -1.3  # rad: so far bent is the right elbow while the robot waves
PATIENCE = 120.0  # s that a busy machine may take until it has waved


def main() -> int:
    """All three; 1 where there is no browser or one is too large."""
    if why := missing():
        print(f"no pictures: {why}", file=sys.stderr)
        return 1
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="twind-pictures-") as made, robot() as (virtual, folder):
        recording = Path(made) / "wave.mcap"
        punctual(virtual.process.pid)
        with daemon(virtual, folder) as running:
            running.reach(state="connected")
            with recorded(running, recording), waving(running):
                shown(running, FOLDER / "monitor.svg")
            seen(running, FOLDER / "view.png")
        plot = [
            sys.executable,
            "-m",
            "twind.ctl.ctl_main",
            "plot",
            str(recording),
            "--out",
            str(FOLDER / "plot.png"),
        ]
        subprocess.run(plot, check=True)
    smaller(FOLDER / "view.png")
    smaller(FOLDER / "plot.png")
    sizes = {each: each.stat().st_size for each in sorted(FOLDER.iterdir())}
    for each, size in sizes.items():
        print(f"{each}: {size} bytes")
    return int(max(sizes.values()) > MOST)


def punctual(pid: int) -> None:
    """Virtual servos answer as real ones do, whoever else computes, such as a browser that draws."""
    with suppress(PermissionError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(20))


def ctl(running: Daemon, *words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


@contextmanager
def recorded(running: Daemon, out: Path) -> Iterator[None]:
    """All that happens meanwhile is in that file."""
    with ctl(running, "record", "--out", str(out), "--free", "0") as recorder:
        until(out.exists, 20.0, "no recording")
        try:
            yield
        finally:
            recorder.terminate()
            recorder.wait(20.0)


@contextmanager
def waving(running: Daemon) -> Iterator[None]:
    """The arm is up; afterwards until it has waved."""
    with ThreadPoolExecutor(1) as pool:
        waved = pool.submit(wave, running)
        until(lambda: waved.done() or bent(running) < UP, 2 * PATIENCE, "it did not wave")
        try:
            yield
        finally:
            waved.result()


def shown(running: Daemon, out: Path) -> None:
    """Screen of `twindctl monitor` in a terminal that is tall enough."""
    feed = MonitorFeed(lambda: Client(str(running.sockets), name="observe"), rate=20.0)
    time.sleep(1.5)  # histograms come once a second
    out.write_text(svg(feed.watched.view(time.monotonic()), title="twindctl monitor", width=120, height=60))
    feed.close()


def seen(running: Daemon, out: Path) -> None:
    """Browser's picture while the robot waves once more."""
    with ctl(running, "view") as viewer, browser() as found:
        try:
            assert viewer.stdout is not None
            url = re.search(r"http://\S+", viewer.stdout.readline())
            assert url is not None, "the viewer has no address"
            page = opened(found, url[0], SIZE)
            page.add_style_tag(
                content=".mantine-Notifications-root {display: none}"
            )  # that WebGL is software
            page.locator("[data-twind-row]").first.wait_for(timeout=60_000)  # the robot was described
            page.wait_for_timeout(3000.0)  # its meshes come one by one
            # Whether it waves to its end beside a browser is no part of the picture.
            threading.Thread(target=tried, args=(running,), daemon=True).start()
            until(lambda: bent(running) < UP, 2 * PATIENCE, "it did not wave")
            page.wait_for_timeout(1000.0)
            page.screenshot(path=str(out))
        finally:
            viewer.terminate()
            viewer.wait(20.0)


def bent(running: Daemon) -> float:
    """Angle of the right elbow, rad."""
    with running.client() as client:
        joints = client.call("GetStatus", joints=True)["joints"]
    (elbow,) = [joint["position"] for joint in joints if joint["name"] == "r_elbow"]
    return 0.0 if elbow is None else float(elbow)


def wave(running: Daemon) -> None:
    """An episode: it waves; then it is asked for what cannot be. It stays armed."""
    with running.client() as client, running.client() as marking:
        if not running.status()["armed"]:
            arm(client)
        marking.call("Mark", kind="begin", task="wave")
        go(client, load_motion("wave"), PATIENCE)
        marking.call("Mark", kind="end", success=True)
        client.call("AcquireLease")
        try:
            points = [{"positions": [9.0], "time_from_start": 1.0}]
            client.call("SubmitTrajectory", trajectory={"joint_names": ["head_yaw"], "points": points})
        except Refused as refusal:
            print(f"refused, as it must be: {refusal.findings[0]['message']}")


def tried(running: Daemon) -> None:
    with suppress(AssertionError, ClientError):
        wave(running)


def smaller(path: Path) -> None:
    """The same picture with fewer colours."""
    with Image.open(path) as image:
        image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
