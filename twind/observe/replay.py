"""Replay a flight file into a daemon and compare the results.

The daemon writes a flight file at a fault, and `twindctl dump` writes one. Its servos answer on
pseudo-terminals with the recorded bytes, noise, cuts and silence included. A separate daemon with the
recorded robot, calibration and settings gets the recorded commands at the same times. Verdicts, lasting
faults and the final state are compared. Exit code 0: the same; 1: different, too incomplete to decide, or
not playable.

No port of this machine is opened, no daemon of it is contacted, and nothing in the file is executed. The
replay begins at the first moment at which the robot is at rest without a fault. Only serial buses
(Dynamixel) are played. A file with CAN buses, and a recording as .mcap (it has states, no bytes), can be
shown with --view.
"""

import argparse
import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, harmless, show
from twind.exceptions import InvalidInput, OperationFailed

if TYPE_CHECKING:
    from twind.flight import LoadedFlight
    from twind.observe.replaying.replay_bus import ReplayBus
    from twind.observe.replaying.replay_outcome import RunOutcome
    from twind.observe.replaying.replay_script import ReplayScript
    from twind.observe.replaying.replay_servos import ReplayPosition

group = "record"

TOLERANCE = 0.25  # s that a fault may come earlier or later than it was recorded
LONGEST = 60  # characters of a folder in which sockets can lie in folders
ON_ITS_WAY = 0.001  # s that an answer takes from our thread through a pseudo-terminal to a daemon, with luck


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """A recording, played."""

    asked: "ReplayScript"
    outcome: "RunOutcome"
    verbatim: float  # share of the questions that were answered with recorded bytes
    missed: int  # ticks of the daemon


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("file", metavar="FILE", help="a flight file; with --view a recording (.mcap) too")
    parser.add_argument(
        "--last", type=float, default=float("inf"), metavar="S", help="play only the last S seconds"
    )
    parser.add_argument(
        "--view", action="store_true", help="show its states in a browser; no daemon is started"
    )
    parser.add_argument(
        "--speed", type=float, metavar="X", help="with --view: so many times as fast (default 1)"
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="before the other programs of this machine, but for the daemon of a robot: where it is busy",
    )
    parser.add_argument(
        "--robot",
        metavar="FILE",
        help="this robot file, where the recorded one names meshes that are not in it",
    )


def run(options: argparse.Namespace) -> int:
    """Play or show it. Raises Rejected: it cannot be played; UsageError."""
    if options.speed is not None and not (options.view and 0.01 <= options.speed <= 100.0):
        raise UsageError("--speed X goes with --view and is 0.01 to 100: servos and a daemon keep real time")
    if not options.last > 0.0:
        raise UsageError(f"--last {options.last:g}: seconds of the recording, more than 0")
    if options.view:
        return _view(options)
    path = Path(options.file)
    flight = load_flight(path)
    robot = None if options.robot is None else Path(options.robot)
    return _report(options, flight, _play(path, flight, robot, options.last, realtime=options.realtime))


def load_flight(path: Path) -> "LoadedFlight":
    """Return the flight file. Raises UsageError (a recording), Rejected (no such file, not readable)."""
    from twind.flight import load
    from twind.observe.recording.unopened_file import unopened

    if path.suffix == ".mcap":
        raise UsageError(
            f"{path}: a recording has states and no bytes of a bus: `twindctl replay --view {path}`"
        )
    try:
        return load(path)
    except OSError as error:
        raise unopened(path, error) from None
    except InvalidInput as error:
        raise Rejected(str(error)) from None


# ------------------------------------------------------------------------------------------- playing


def script_of(path: Path, flight: "LoadedFlight", last: float) -> "ReplayScript":
    """Return what is played of a flight file. Raises OperationFailed, Rejected: it has no such content."""
    from twind.observe.recording.foreign_content import refuse_foreign_content
    from twind.observe.replaying.replay_script import score

    with refuse_foreign_content(path):
        _require_serial(flight)
        return score(flight, last)


def _play(
    path: Path, flight: "LoadedFlight", robot: Path | None, last: float, *, realtime: bool
) -> "ReplayResult":
    """Raises Rejected."""
    from twind.observe.recording.foreign_content import refuse_foreign_content
    from twind.observe.replaying.replay_client import ReplayClient
    from twind.observe.replaying.replay_daemon import ReplayDaemon
    from twind.observe.replaying.replay_files import lay_out
    from twind.observe.replaying.replay_ports import ReplayPorts
    from twind.observe.replaying.replay_servos import ReplayPosition
    from twind_drivers.clock import MonotonicClock

    clock = MonotonicClock()
    try:
        asked = script_of(path, flight, last)
        passage = ReplayPosition(asked.begin)
        with contextlib.ExitStack() as stack:
            short = None if len(tempfile.gettempdir()) < LONGEST else "/tmp"  # a socket's path is 107 bytes
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="twind-replay-", dir=short)))
            files = lay_out(flight.briefing, folder, robot)
            places = folder / "ports", folder / "run"
            for place in places:
                place.mkdir()
            with refuse_foreign_content(path):
                buses = list(_buses(flight, asked, passage, clock.now))
            links = {name: places[0] / str(place) for place, name in enumerate(files.buses)}
            ports = stack.enter_context(ReplayPorts(buses, links, clock, realtime=realtime))
            daemon = stack.enter_context(ReplayDaemon(files, asked.mode, links, places[1], realtime=realtime))
            conductor = stack.enter_context(
                contextlib.closing(ReplayClient(asked, daemon.sockets, passage, clock))
            )
            conductor.prepare()
            replayed = conductor.play()
            ports.check()
            verbatim, made = (sum(getattr(bus, what) for bus in buses) for what in ("verbatim", "made"))
            return ReplayResult(asked, replayed, verbatim / max(1, verbatim + made), conductor.missed)
    except OperationFailed as error:
        raise Rejected(f"this file cannot be played: {error}") from None


def _require_serial(flight: "LoadedFlight") -> None:
    """Raises OperationFailed: a bus of another driver family than the one that is played."""
    from twind.observe.replaying.replay_bus import ReplayBus
    from twind.observe.replaying.replay_script import VIEW

    for bus in flight.briefing.description["buses"]:
        if bus["kind"] != ReplayBus.kind:
            kinds = f"of kind {bus['kind']}: only buses of kind {ReplayBus.kind} are played"
            raise OperationFailed(f"bus {bus['name']} is {kinds}; {VIEW}")


def _buses(
    flight: "LoadedFlight", asked: "ReplayScript", recording: "ReplayPosition", now: Any
) -> Iterator["ReplayBus"]:
    from twind.observe.replaying.device_state_tracker import story
    from twind.observe.replaying.replay_bus import ReplayBus
    from twind.observe.replaying.replay_script import SIM

    for place, bus in enumerate(flight.briefing.description["buses"]):
        if asked.mode == SIM:  # its port is given a name all the same, behind which there is nothing
            continue
        yield ReplayBus(
            story(bus["name"], place, flight.contents),
            recording,
            baud=bus["baud"],
            period=1.0 / flight.briefing.rate_hz,
            armed=asked.armed,
            now=now,
            leads=place == 0,
            head_start=ON_ITS_WAY,
        )


# ------------------------------------------------------------------------------------------- telling


def _report(options: argparse.Namespace, flight: "LoadedFlight", played: ReplayResult) -> int:
    from twind.observe.replaying.replay_outcome import differences, uncompared

    score = played.asked
    found = list(differences(score.recorded, played.outcome, TOLERANCE))
    open_ = list(uncompared(score.recorded, played.outcome))
    doubts = list(_doubts(played))
    told = {
        "file": options.file,
        "version": flight.briefing.version,
        "seconds": round(score.end - score.begin, 3),
        "verbatim": round(played.verbatim, 3),
        "missed": played.missed,
        "left_out": list(score.left_out),
        "recorded": score.recorded.plain(),
        "replayed": played.outcome.plain(),
        "not_compared": open_,
        "doubts": doubts,
        "differences": found,
    }
    lines = (
        *_head(options.file, flight, played),
        *_verdict(played, found, doubts, open_),
        *_details(played, differ=bool(found)),
    )
    show(options, told, "\n".join(map(harmless, lines)))
    return REFUSED if found or doubts else DONE


def _doubts(played: ReplayResult) -> Iterator[str]:
    """Why it proves nothing that the same came out."""
    from twind.observe.replaying.replay_script import SIM

    if not played.asked.whole:
        yield "not all was asked again that may have changed what came out"
    if played.asked.mode != SIM and not played.verbatim:
        yield "no question had its recorded answer"


def _head(file: str, flight: "LoadedFlight", played: ReplayResult) -> Iterator[str]:
    briefing = flight.briefing
    score = played.asked
    seconds = score.end - score.begin
    yield f"{file}: {briefing.robot}, {score.mode}, recorded by twind {briefing.version}"
    yield f"played {seconds:.1f} s; {played.verbatim:.0%} of the questions had their recorded answers"


def _verdict(
    played: ReplayResult, found: Sequence[str], doubts: Sequence[str], open_: Sequence[str]
) -> Iterator[str]:
    if found:
        yield "different:"
        yield from (f"  {each}" for each in found)
    elif doubts:
        yield f"replayed: nothing differs, which does not say that it is the same: {'; '.join(doubts)}"
    else:
        yield f"replayed: the same (times of faults within {TOLERANCE:g} s)"
    if open_:
        yield f"not compared, {len(open_)}:"
        yield from (f"  {each}" for each in open_)
    ticks = (
        f"{played.missed} ticks: repeat it where there is more, or with --realtime"
        if played.missed
        else "every tick"
    )
    yield f"this machine had {'no ' if played.missed else ''}time for {ticks}"


def _details(played: ReplayResult, *, differ: bool) -> Iterator[str]:
    yield from (f"not asked again: {what}" for what in played.asked.left_out)
    yield from _outcome("recorded", played.asked.recorded)
    if differ:
        yield from _outcome("replayed", played.outcome)


def _outcome(what: str, outcome: "RunOutcome") -> Iterator[str]:
    yield f"{what}:"
    for number, each in enumerate(outcome.answers, 1):
        yield f"  {number:3}  {each.words()}"
    for (code, joint), time in sorted(outcome.faults.items(), key=lambda each: each[1]):
        yield f"  fault {code}{'' if joint is None else ' ' + joint} after {time:.2f} s"
    yield f"  at the end {outcome.state}, {outcome.mode}, {'armed' if outcome.armed else 'not armed'}"


# ------------------------------------------------------------------------------------------- looking


def _view(options: argparse.Namespace) -> int:
    """The states in the viewer, until Ctrl-C."""
    from twind.observe.recording import open_recording
    from twind.observe.replaying.recorded_states import messages
    from twind.observe.viewing import show as show_in_browser
    from twind.observe.viewing.robot_model import RobotModel
    from twind_drivers.clock import MonotonicClock

    recording = open_recording(Path(options.file))
    if recording.robot is None or recording.mjcf is None:
        raise Rejected(
            f"{options.file}: there is no robot in it to be shown; record it with `twindctl record`"
        )
    robot = {"robot": recording.robot, "calibration": recording.calibration, "mjcf": recording.mjcf}
    try:
        RobotModel(robot)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise Rejected(f"{options.file}: the robot in it cannot be shown: {error!r}") from None
    paced = messages(recording, MonotonicClock(), options.speed or 1.0)
    return show_in_browser(robot, paced, title=f"{recording.path.name}")
