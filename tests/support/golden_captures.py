"""Golden captures: recordings of injected faults, made from a virtual robot over real pseudo-terminals.

`python tests/support/golden_captures.py make [NAME ...]` makes them anew;
`python tests/support/golden_captures.py cut FILE NAME [SECONDS]` makes one of a flight file that somebody
sent; `python tests/support/golden_captures.py expect [NAME ...]` writes anew what must come out. Look at
NAME.expected.json before you commit it.
"""

import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from tests.support.processes import Daemon, Virtual, daemon, patiently, robot
from tests.support.replay_rig import Replay, figures
from twind.briefing import Briefing
from twind.client.errors import as_error
from twind.flight import EntryKind, FlightContents, FlightEntry, LoadedFlight, load, save
from twind.link import Overview, Tick, decode_news
from twind.observe.recording.flight_monitor_messages import news
from twind.observe.replaying.replay_calls import INTERFACE, ReplayConnection, wait
from twind.observe.replaying.replay_outcome import CommandOutcome, RunOutcome
from twind.observe.replaying.replay_script import score

HERE = Path(__file__).parents[1] / "data" / "captures"
LARGEST = 150_000  # bytes of a capture
STATES = 10  # of so many one state is kept, but for those in which something changed
MARGIN = 0.03  # of the share of recorded answers, for those that another version asks a little later
FOLDERS = re.compile(r"/(?:\S*/robots|tmp/[^/\s]+)/")  # of the robot files, of what was recorded
JOINT = "head_yaw"
TO_AND_FRO = ((0.2, 1.0), (-0.2, 2.2), (0.0, 3.2))


class Hand:
    """Client that commands the recorded robot: calls on one connection, each with all its replies."""

    def __init__(self, virtual: Virtual, running: Daemon) -> None:
        self.virtual = virtual
        self.running = running
        self._line = ReplayConnection(running.sockets / "control.sock")

    def say(self, method: str, *, more: bool = False, **parameters: Any) -> list[Any]:
        """A call; its answers appear in what is returned."""
        found: list[Any] = []
        self._line.send(method, parameters, found.append, more=more)
        return found

    def ask(self, method: str, **parameters: Any) -> Any:
        """A call and its answer. Raises CallError."""
        found = self.say(method, **parameters)
        while not found:
            wait([self._line], 1.0)
        said, error, _ = found[0]
        if error is not None:
            raise as_error(f"{INTERFACE}.{error}", said)
        return said

    def pass_time(self, seconds: float) -> None:
        """Let it happen, holding the lease."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            wait([self._line], min(left, 0.3))

    def move(self, *points: tuple[float, float], joint: str = JOINT) -> None:
        """Positions (rad) and times (s) of one joint, followed to the end."""
        rows = [
            {"positions": [position], "velocities": [0.0], "time_from_start": at}
            for position, at in points or TO_AND_FRO
        ]
        self.ask("AcquireLease")
        self.say("SubmitTrajectory", more=True, trajectory={"joint_names": [joint], "points": rows})

    def close(self) -> None:
        """Hang up."""
        self._line.close()

    def fault(self, name: str, **arguments: Any) -> None:
        """Order it."""
        self.virtual.order(fault=name, **arguments)


# ------------------------------------------------------------------------------------------- what happens


def silent(hand: Hand) -> None:
    """A servo falls silent in a motion; the next motion is refused."""
    hand.move()
    hand.pass_time(0.7)
    hand.fault("silence", id=3)
    hand.pass_time(1.0)
    hand.move()
    hand.pass_time(0.3)


def overload(hand: Hand) -> None:
    """A servo shuts itself down in a motion; the next motion is refused."""
    hand.move()
    hand.pass_time(0.7)
    hand.fault("damage", id=1, bits=32)
    hand.pass_time(1.0)
    hand.move()
    hand.pass_time(0.3)


def noise(hand: Hand) -> None:
    """Noise, flipped bits and lost answers that a motion rides out."""
    hand.move()
    hand.pass_time(0.6)
    hand.fault("corrupt", count=1, bits=3)
    hand.pass_time(0.8)
    hand.fault("noise", seconds=0.002)
    hand.pass_time(0.8)
    hand.fault("drop", count=1, id=7)
    hand.pass_time(1.5)


def unplug(hand: Hand) -> None:
    """The adapter is pulled out in a motion and put back in; a motion is refused until somebody arms anew."""
    hand.move()
    hand.pass_time(0.7)
    hand.fault("unplug")
    hand.pass_time(0.6)
    hand.fault("replug")
    hand.pass_time(1.2)
    hand.move()
    hand.pass_time(0.3)
    hand.say("Disarm")
    hand.say("Reset")
    hand.pass_time(0.5)


def limit(hand: Hand) -> None:
    """A motion beyond a limit is refused, the next one is not."""
    hand.move((4.0, 3.0))
    hand.pass_time(0.2)
    hand.move((0.2, 1.0))
    hand.pass_time(1.4)


def estop(hand: Hand) -> None:
    """Torque is cut in a motion; a motion is refused until the stop is acknowledged."""
    hand.move()
    hand.pass_time(0.7)
    hand.ask("EStop", level="cut", reason="somebody stands too near")
    hand.pass_time(0.4)
    hand.move()
    hand.pass_time(0.2)
    hand.say("Reset")
    hand.pass_time(0.5)


SCENES: Mapping[str, Callable[[Hand], None]] = {
    each.__name__: each for each in (silent, overload, noise, unplug, limit, estop)
}

# ------------------------------------------------------------------------------------------- making


@contextmanager
def stage(*options: str) -> Iterator[tuple[Virtual, Daemon]]:
    """A virtual robot and its daemon, which keeps its files in a folder of its own; connected."""
    with robot("h24", "--seed", "1", *options) as (virtual, folder):
        config = folder / "twind.yaml"
        config.write_text(f"state_dir: {folder / 'state'}\n")
        with daemon(virtual, folder, more=["--config", str(config)]) as running:
            running.reach(state="connected")
            yield virtual, running


def record(scene: Callable[[Hand], None], file: Path) -> float:
    """A scene, recorded as `file`: when it began, s monotonic. The robot is armed before it."""
    with stage("--muscles", "first-order") as (virtual, running):  # physics would want a core of its own
        hand = Hand(virtual, running)

        def armed() -> None:
            hand.ask("AcquireLease")
            hand.ask("Arm")

        patiently(armed)
        hand.pass_time(0.5)
        hand.ask("AcquireLease")
        begun = time.monotonic()
        hand.pass_time(0.2)
        scene(hand)
        path = hand.ask("DumpRecorder", name=file.stem)["path"]
        file.write_bytes(Path(path).read_bytes())
        hand.close()
        running.end()
    return begun


def cut(flight: LoadedFlight, begin: float, end: float = float("inf")) -> LoadedFlight:
    """From `begin` to `end` (s monotonic), with fewer states."""
    kept = tuple(_thinned([each for each in flight.contents.entries if begin <= each.time <= end]))
    return LoadedFlight(flight.meta, flight.briefing, FlightContents(flight.contents.kept, kept))


def _thinned(entries: Sequence[FlightEntry]) -> Iterator[FlightEntry]:
    """Most states tell what the last one told, and are half of all bytes."""
    before = None
    number = 0
    last = max((place for place, each in enumerate(entries) if _tick(each)), default=-1)
    for place, each in enumerate(entries):
        tick = _tick(each)
        if tick is not None:
            number += 1
            told = (tick.state, tick.motion, tick.armed, tick.mode, tick.heard)
            if told == before and number % STATES and place != last:
                continue
            before = told
        elif each.kind == EntryKind.NEWS and isinstance(decode_news(each.data), Overview):
            number = STATES - 1  # the state of the same tick explains it
        yield each


def _tick(entry: FlightEntry) -> Tick | None:
    found = decode_news(entry.data) if entry.kind == EntryKind.NEWS else None
    return found if isinstance(found, Tick) else None


def nowhere(flight: LoadedFlight) -> LoadedFlight:
    """Without the folders of the machine that it was recorded on."""

    def plain(value: Any) -> Any:
        if isinstance(value, str):
            return FOLDERS.sub("/recorded/", value)
        if isinstance(value, dict):
            return {plain(key): plain(each) for key, each in value.items()}
        return [plain(each) for each in value] if isinstance(value, list | tuple) else value

    def entry(each: FlightEntry) -> FlightEntry:
        if each.kind == EntryKind.PORT:
            return each._replace(data=plain(each.data.decode()).encode())
        if each.kind not in (EntryKind.NEWS, EntryKind.COMMAND):
            return each
        return each._replace(data=msgspec.msgpack.encode(plain(msgspec.msgpack.decode(each.data))))

    briefing = msgspec.convert(plain(msgspec.to_builtins(flight.briefing)), Briefing)
    entries = tuple(entry(each) for each in flight.contents.entries)
    return LoadedFlight(flight.meta, briefing, FlightContents(flight.contents.kept, entries))


def keep(flight: LoadedFlight, name: str, why: str) -> None:
    """Write the capture, and what must come out of it: what the recorded daemon said."""
    HERE.mkdir(exist_ok=True)
    flight = nowhere(flight)
    briefing = msgspec.structs.replace(flight.briefing, binding=b"", described=b"")
    path = HERE / f"{name}.flight"
    save(path, {"why": why}, msgspec.msgpack.encode(briefing), flight.contents)
    path.chmod(0o644)
    assert path.stat().st_size < LARGEST, f"{path}: {path.stat().st_size} bytes, at most {LARGEST}: cut it"
    expect(name)


def outcome_of(plain: Mapping[str, Any]) -> RunOutcome:
    """Return the outcome that `RunOutcome.plain` wrote. Raises KeyError."""
    return RunOutcome(
        tuple(
            CommandOutcome(
                each["method"],
                each["error"],
                tuple((found["code"], found["joint"]) for found in each["findings"]),
                each["phase"],
                each["answered"],
            )
            for each in plain["answers"]
        ),
        {(each["code"], each["joint"]): each["time"] for each in plain["faults"]},
        plain["state"],
        plain["mode"],
        plain["armed"],
    )


def expected(name: str) -> RunOutcome:
    """Expected result."""
    return outcome_of(json.loads((HERE / f"{name}.expected.json").read_text()))


def expected_figures(name: str) -> dict[str, Any]:
    """Numbers that must come out, and the share of questions (`verbatim`) with their recorded answers."""
    found: dict[str, Any] = json.loads((HERE / f"{name}.expected.json").read_text())["figures"]
    return found


def names() -> list[str]:
    """Names of all captures."""
    return sorted(path.stem for path in HERE.glob("*.flight"))


def expect(name: str) -> None:
    """Write what must come out of a capture anew: what its daemon said, and how much of it is played."""
    recorded = load(HERE / f"{name}.flight")
    asked = score(recorded)
    with tempfile.TemporaryDirectory() as folder:
        replay = Replay(recorded, Path(folder))
        replay.run()
        verbatim = replay.verbatim
        replay.close()
    told = {"why": recorded.meta["why"]} | asked.recorded.plain()
    share = {"verbatim": round(verbatim - MARGIN, 2)}
    told["figures"] = share | figures(asked, asked.begin, list(news(recorded)))
    (HERE / f"{name}.expected.json").write_text(json.dumps(told, indent=1) + "\n")


def main(arguments: Sequence[str]) -> None:
    if arguments[:1] == ["cut"]:
        flight = load(arguments[1])
        seconds = float(arguments[3]) if len(arguments) > 3 else 30.0
        keep(cut(flight, flight.contents.entries[-1].time - seconds), arguments[2], Path(arguments[1]).name)
        return
    if arguments[:1] == ["nowhere"]:
        for name in arguments[1:] or names():
            flight = load(HERE / f"{name}.flight")
            keep(flight, name, flight.meta["why"])
        return
    if arguments[:1] == ["expect"]:
        for name in arguments[1:] or names():
            expect(name)
        return
    assert arguments[:1] == ["make"], __doc__
    for name in arguments[1:] or SCENES:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{name}.flight"
            begun = record(SCENES[name], file)
            keep(cut(load(file), begun), name, (SCENES[name].__doc__ or "").strip())
        print(f"{name}: {(HERE / name).with_suffix('.flight').stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
