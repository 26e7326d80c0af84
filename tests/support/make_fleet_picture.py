"""`make pictures`: docs/pictures/fleet.png, four simulated robots by their uplinks, as Chromium shows them.

One waves, one was stopped, one holds, one is lost.
"""

import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.browser import SIZE, browser, missing, opened
from tests.support.make_pictures import FOLDER, MOST, smaller
from tests.support.processes import Daemon, Moving, simulated, twindctl, until
from tests.support.zenoh_router import Router
from twind.command_line.trajectory_files import load_motion

WAVES, STOPPED, HOLDS, LOST = ROBOTS = ("anna", "bruno", "clara", "dora")
PATIENCE = 60_000  # ms that a busy machine may take until the page says what is so
TRIES = 10  # of a wave that a busy machine ends
ARM = 3.0  # s after its begin the arm is up


def main() -> int:
    """1 where there is no browser or the picture is too large."""
    if why := missing():
        print(f"no picture: {why}", file=sys.stderr)
        return 1
    out = FOLDER / "fleet.png"
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="twind-pictures-")))
        router = stack.enter_context(Router())
        robots = {name: stack.enter_context(simulated(folder / name)) for name in ROBOTS}
        uplinks = {
            name: stack.enter_context(
                twindctl(
                    "--socket", str(folder / name), "uplink", "--name", name, "--connect", router.endpoint
                )
            )
            for name in ROBOTS
        }
        view = stack.enter_context(twindctl("fleet", *ROBOTS, "--view", "--connect", router.endpoint))
        assert view.stdout is not None
        pictured(view.stdout.readline().split()[1], robots, uplinks[LOST], out)
    smaller(out)
    print(f"{out}: {out.stat().st_size} bytes")
    return int(out.stat().st_size > MOST)


def pictured(url: str, robots: dict[str, Daemon], lost: "subprocess.Popen[str]", out: Path) -> None:
    """All are seen; then each does what it is there for."""
    with browser() as found:
        page = opened(found, url, SIZE, shows=f"E-STOP {LOST}")
        page.add_style_tag(content=".mantine-Notifications-root {display: none}")  # that WebGL is software
        page.get_by_text("4 well").wait_for(timeout=PATIENCE)
        lost.terminate()
        page.get_by_role("button", name=f"E-STOP {STOPPED}", exact=True).dispatch_event("click")
        page.get_by_text("1 e-stop, 1 lost").wait_for(timeout=PATIENCE)
        for _ in range(TRIES):
            waving = Moving(robots[WAVES], load_motion("wave"))
            until(lambda waving=waving: waving.last, 10.0, "an answer to the wave")
            page.wait_for_timeout(ARM * 1e3)
            page.screenshot(path=str(out))
            if waving.last == "running" and page.get_by_text("1 e-stop, 1 lost, 1 moving").count():
                return
            waving.join()
    raise RuntimeError("it did not wave: the machine is too busy")


if __name__ == "__main__":
    sys.exit(main())
