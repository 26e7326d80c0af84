"""`twindctl calibrate sweep`: reads the daemon while the joints are moved by hand, and writes the draft.

Blocks.
"""

import argparse
import json
import select
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from twind.client import Client, ClientError
from twind.command_line.keep_torque_off import limp, require_limp
from twind.command_line.stop_signals import interrupt_on_terminate
from twind.command_line.verb import DONE, REFUSED, Rejected, observer, operator
from twind.config.calibrated_device import DeviceRecord
from twind.ctl.hint_options import command_hint
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground, now
from twind_calibration.calibrating.calibration_draft import DraftTravel
from twind_calibration.calibrating.calibration_steps import format_option
from twind_calibration.calibrating.joint_capture import RawExchange, readings
from twind_calibration.calibrating.recorded_devices import of_file, records
from twind_calibration.calibrating.sweep_display import SweepDisplay, line
from twind_calibration.calibrating.sweep_tracker import (
    SweepEvent,
    SweepStage,
    SweepTracker,
    describe_open_limits,
)
from twind_calibration.calibrating.zero_placement import travel_of
from twind_calibration.rejection_hints import with_hints
from twind_drivers.clock import Clock, MonotonicClock

REDRAW = 0.1  # s
TELL = 0.5  # s between two lines of JSON of a joint that moves
HEAD = "by hand, slowly, to both ends, half a second at each"


@with_hints
def sweep(options: argparse.Namespace) -> int:
    """Return exit code 0 when all requested actuators have a travel. Raises Rejected, ClientError."""
    with operator(options) as client:
        return _sweep(options, client, MonotonicClock())


def _sweep(options: argparse.Namespace, client: Client, clock: Clock) -> int:
    place = ground(options, client)
    every = slots(place.robot)
    names = [slot.name for slot in every]
    draft = drafts.load(place.path, place.robot)
    calibration = place.calibration()
    known = set(draft.swept) | (set() if calibration is None else set(calibration.by_name))
    asked = [
        name
        for name in place.select_actuators(options.joints, names)
        if options.joints or options.again or name not in known
    ]
    session = SweepSession(options, place, every, asked, clock)
    if not asked:
        session.close()
        return DONE
    drafts.require_room(place.path)  # before anybody moves anything
    session.draft = draft
    require_limp(client, clock)
    session.records = records(client, place.robot, every, of_file(calibration) | draft.devices)
    with (
        interrupt_on_terminate(),
        limp(client, clock, take=options.take) as keep,
        observer(options) as watching,
        readings(watching, place.rate_hz) as stream,
    ):
        session.begin()
        try:
            for reading in stream:
                keep()
                if session.take(reading):
                    break
        except (KeyboardInterrupt, ClientError):
            session.cut()
            raise
    session.save(at_once=True)
    return session.close()


class SweepSession:
    """State of one sweep: the progress of every actuator, the printed messages, the content of the draft."""

    def __init__(
        self,
        options: argparse.Namespace,
        place: CalibrationContext,
        every: tuple[CalibrationActuator, ...],
        asked: list[str],
        clock: Clock,
    ) -> None:
        self.draft = drafts.CalibrationDraft()
        self.records: Mapping[str, DeviceRecord] = {}
        self._options = options
        self._place = place
        self._clock = clock
        self._slots = {slot.name: slot for slot in every}
        self._asked = asked
        self._travels = SweepTracker(every, asked, wide=options.wide)
        columns, rows = shutil.get_terminal_size()
        self._board = SweepDisplay(live=sys.stdout.isatty() and not options.json, rows=rows, columns=columns)
        self._begun = clock.now()
        self._drawn = 0.0
        self._told = dict.fromkeys(asked, 0.0)

    def begin(self) -> None:
        """Print the instructions and discard earlier travels of these joints.

        Raises Rejected: a joint is absent.
        """
        absent = [name for name in self._asked if name not in self.records]
        if absent:
            raise Rejected(
                f"no device answers for {', '.join(absent)}: `twindctl calibrate scan` examines the buses"
            )
        self._forget(self._asked)  # else an earlier travel would pass for one of this sweep
        count = f"{len(self._asked)} joints" if len(self._asked) > 1 else self._asked[0]
        ends = "; ENTER ends it with what is done" if sys.stdin.isatty() else ""
        self._print_line(f"move {count} {HEAD}{ends}")
        unknown = [name for name in self._asked if self._slots[name].is_open]
        if unknown:
            self._print_line(describe_open_limits(unknown, "ENTER" if ends else "--timeout"))

    def take(self, reading: RawExchange) -> bool:
        """Process one reading; return whether the sweep is over."""
        for news in self._travels.take(reading.samples):
            self._news(news)
        self._show(reading.time)
        late = self._options.timeout is not None and self._clock.now() - self._begun > self._options.timeout
        return late or self._entered() or self._travels.is_finished

    def save(self, *, at_once: bool) -> None:
        """Write the completed travels to the draft.

        `at_once`: also those that fit although the joint has not rested at both ends.
        """
        for name in self._asked:
            found = self._travels.travel(name, at_once=at_once)
            if found is not None:
                self._keep(name, found)

    def cut(self) -> None:
        """Report an interruption: the open joints, each with reason and next step, and the saved travels.

        Ctrl-C, SIGTERM, a daemon that ends and a lost lease interrupt a sweep.
        """
        left = self._left()
        if self._options.json:
            self._print_summary(left, interrupted=True)
            return
        self._print_left(left)
        self._print_line(
            f"interrupted: {len(self._asked) - len(left)} of {len(self._asked)} are kept in "
            f"{drafts.path_of(self._place.path)}; `{self._next()}` continues with the others"
        )

    def close(self) -> int:
        """Print the complete and the incomplete actuators; return the exit code."""
        left = self._left()
        whole = not left
        if self._options.json:
            self._print_summary(left, interrupted=False)
            return DONE if whole else REFUSED
        if not self._asked:
            self._print_line("every joint has its travel already: --again, or names, sweep them anew")
            return DONE
        self._print_left(left)
        done = len(self._asked) - len(left)
        where = f", kept in {drafts.path_of(self._place.path)}" if done else ""
        self._print_line(f"{done} of {len(self._asked)} swept{where}")
        what = "hold the robot in a pose whose angles are known" if whole else "the rest"
        self._print_line(f"next: `{self._next()}`, {what}")
        return DONE if whole else REFUSED

    def _print_summary(self, left: Sequence[str], *, interrupted: bool) -> None:
        """Print the last line of JSON."""
        summary = {
            "done": [name for name in self._asked if name not in left],
            "left": {name: self._travels.open_reason(name) for name in left},
            "interrupted": interrupted,
            "draft": str(drafts.path_of(self._place.path)),
            "next": command_hint(self._options).command(self._next()),
        }
        print(json.dumps(summary), flush=True)

    def _next(self) -> str:
        """Return the command that continues the calibration."""
        left = self._left()
        anew = self._options.joints or self._options.again  # what the file has of them is not enough
        names = "".join(f" {name}" for name in left) if anew else ""
        return f"twindctl calibrate {f'sweep{names}' if left else 'zero'}{format_option(self._options)}"

    def _left(self) -> list[str]:
        """Return the requested joints without a travel."""
        return [name for name in self._asked if name not in self.draft.swept]

    def _print_left(self, left: Iterable[str]) -> None:
        """Print the last progress, and a line with reason and next step for each open joint."""
        self._draw()
        self._board.close()
        for name in left:
            self._print_line(f"not done: {name}: {self._travels.open_reason(name)}")

    def _keep(self, name: str, travel: tuple[int, int]) -> None:
        """Store a travel in the draft, in the frame of the calibration file."""
        record = self.records[name]
        swept = travel_of(self._slots[name], record, travel)
        before = self.draft.swept.get(name)
        if before is None or (before.sweep_ticks, before.device) != (swept, record):
            fresh = DraftTravel(record, swept, now())
            path = self._place.path
            robot = self._place.robot
            self.draft = drafts.change(path, robot, lambda known: known.joined(name, fresh))

    def _forget(self, names: Iterable[str]) -> None:
        """Remove a travel from the draft."""
        if self.draft.without(names) != self.draft:
            path = self._place.path
            robot = self._place.robot
            self.draft = drafts.change(path, robot, lambda known: known.without(names))

    def _news(self, news: SweepEvent) -> None:
        if news.what == "done":
            self.save(at_once=False)
        elif news.what == "wrong":  # it was done, and went further since
            self._forget([news.name])
        if self._options.json:
            print(json.dumps({"joint": news.name, "event": news.what, "text": news.text}), flush=True)
        elif news.what != "done" or not sys.stdout.isatty():
            self._print_line(f"{news.name}: {news.what}: {news.text}")

    def _show(self, time: float) -> None:
        if self._options.json:
            for name in self._asked:
                self._line(name, time)
        elif time - self._drawn >= REDRAW:
            self._drawn = time
            self._draw()

    def _draw(self) -> None:
        width = max(map(len, self._asked), default=1)
        self._board.draw([line(self._travels.progress(name), width) for name in self._asked])

    def _line(self, name: str, time: float) -> None:
        """Print a line of JSON of a moving joint, at intervals."""
        if time - self._told[name] < TELL:
            return
        progress = self._travels.progress(name)
        if progress.stage is SweepStage.MOVING:
            self._told[name] = time
            print(json.dumps({"joint": name, "event": "moving", **_plain(progress)}), flush=True)

    def _entered(self) -> bool:
        if not sys.stdin.isatty() or self._options.json:
            return False
        ready, _, _ = select.select([sys.stdin], [], [], 0.0)
        return bool(ready) and sys.stdin.readline() is not None

    def _print_line(self, text: str) -> None:
        if not self._options.json:
            self._board.print_line(command_hint(self._options).prose(text))


def _plain(progress: Any) -> dict[str, object]:
    return {
        "travel_rad": round(progress.judged.radians, 4),
        "described_rad": round(progress.range, 4),
        "share": round(progress.judged.share, 4),
        "rested": list(progress.ends),
    }
