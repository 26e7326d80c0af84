"""Clients of a replay: send the recorded commands to a daemon at their times, and collect the results."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from twind import link
from twind.client import CallError
from twind.exceptions import OperationFailed
from twind.observe.replaying.replay_calls import ReplayConnection, Reply, call, wait
from twind.observe.replaying.replay_outcome import (
    CommandOutcome,
    Named,
    RunOutcome,
    UnclearedFaults,
    answer,
)
from twind.observe.replaying.replay_script import SIM, STAY, RecordedCommand, ReplayScript
from twind.observe.replaying.replay_servos import ReplayPosition
from twind_drivers.clock import Clock

READY = 30.0  # s until the daemon has found the recorded robot
ANSWER = 20.0  # s that one call of the preparations may take
BRING = 2.0  # s per rad of the way to the recorded goals, and at least
SLIGHT = 1e-4  # rad: counts as there already
EARLY = 0.003  # s from here to the front and on to the loop, with luck
AFTER = 0.5  # s beyond the recording in which answers may come
LAST = 0.1  # s beyond the recording: the state by then is that at its end
RATE = 10.0  # Hz of the statuses that are looked at
RENEW = 0.3  # s between two renewals of the lease


class ReplayClient:
    """The clients of a replay. All times are those of `clock`, which is the daemon's too."""

    def __init__(self, score: ReplayScript, sockets: Path, recording: ReplayPosition, clock: Clock) -> None:
        """Raises NoDaemon."""
        self._score = score
        self._passage = recording
        self._clock = clock
        self._sockets = sockets
        self._lines: dict[int, ReplayConnection] = {}  # by the number of the recorded client; 0: our own
        self._watch = ReplayConnection(sockets / "observe.sock")
        self._status: dict[str, Any] = {}
        self._time = 0.0  # s, of that status
        self._missed = 0
        self._standing = UnclearedFaults()
        self._last = dict[str, Any]()
        self._replies: dict[int, list[Reply]] = {}  # by the place of the command
        self._watch.send("Monitor", {"topics": ["status"], "rate": RATE}, self._see, more=True)

    def close(self) -> None:
        """Hang up."""
        for line in (*self._lines.values(), self._watch):
            line.close()

    @property
    def missed(self) -> int:
        """Ticks that the daemon missed since it was ready: for want of time of this machine."""
        return int(self._status["loop"]["missed"]) - self._missed

    # ------------------------------------------------------------------------------------- before it

    def prepare(self) -> None:
        """The daemon has found the robot, and it is as it was at the beginning. Raises OperationFailed."""
        score = self._score
        wanted = "disconnected" if score.mode == SIM else "connected"
        self._until(lambda: bool(self._status.get("state") == wanted), READY, f"it is not {wanted}")
        if score.armed or score.holder or self._away():
            self._ask("AcquireLease")
            if score.armed:
                self._arm()
            self._bring()
            if not score.holder:
                self._ask("ReleaseLease")
        self._passage.ready = True
        self._missed = int(self._status["loop"]["missed"])
        renewed = self._clock.now()
        if score.mode == SIM:  # no bus asks anything: it begins at once
            self._passage.go(renewed, score.begin)
        while not self._passage.running:
            self._pump(0.005)
            if score.holder and self._clock.now() > renewed + RENEW:
                renewed = self._clock.now()
                self._line(score.holder).send("RenewLease", {}, lambda _: None)
            if self._clock.now() > renewed + READY:
                raise OperationFailed("the daemon does not ask what the recording begins with")

    def _arm(self) -> None:
        """Refused while nothing was read yet of heat and supply, or while a busy machine was late."""
        deadline = self._clock.now() + ANSWER
        while True:
            try:
                self._ask("AcquireLease")  # it may have lapsed meanwhile
                self._ask("Arm")
            except OperationFailed:
                if self._clock.now() > deadline:
                    raise
                self._pump(0.2)
            else:
                return

    def _away(self) -> dict[str, float]:
        """Joints whose goal differs from that at the beginning, and the goal at the beginning, rad."""
        now = self._ask("GetStatus", joints=True)["joints"]
        held = {each["name"]: each["simulated" if each["goal"] is None else "goal"] for each in now}
        then = zip(self._score.names, self._score.goal.tolist(), strict=True)
        return {
            name: goal
            for name, goal in then
            if goal == goal and held[name] is not None and abs(held[name] - goal) > SLIGHT
        }

    def _bring(self) -> None:
        """Move the goals to where they were; else a motion would begin with a jump."""
        away = self._away()
        if not away:
            return
        joints = {each["name"]: each for each in self._ask("GetStatus", joints=True)["joints"]}
        ways = [
            abs(goal - (joints[name]["goal"] or joints[name]["simulated"])) for name, goal in away.items()
        ]
        still = [0.0] * len(away)
        point = {"positions": list(away.values()), "velocities": still}
        point |= {"time_from_start": BRING * max(1.0, *ways)}
        self._ask("SubmitTrajectory", trajectory={"joint_names": list(away), "points": [point]})
        self._until(lambda: self._status["motion"] == "active", ANSWER, "it does not move where it was")
        self._until(lambda: self._status["motion"] != "active", ANSWER, "it does not arrive where it was")

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A call of the one who had the lease, or of our own, and its answer. Raises OperationFailed."""
        found: list[Reply] = []
        self._line(self._score.holder).send(method, parameters, found.append)
        self._until(lambda: bool(found), ANSWER, f"{method} is not answered")
        said, error, _ = found[-1]
        if error is not None:
            raise OperationFailed(f"{method} is refused before the beginning: {CallError(error, said)}")
        return said

    def _until(self, done: Callable[[], bool], seconds: float, why: str) -> None:
        deadline = self._clock.now() + seconds
        while not done():
            if self._clock.now() > deadline or not self._watch.open:
                faults = ", ".join(f"{each['code']}" for each in self._status.get("faults", ()))
                raise OperationFailed(
                    f"{why}: the daemon is {self._status.get('state', 'gone')} {faults}".rstrip()
                )
            self._pump(0.02)

    # ------------------------------------------------------------------------------------- the recording

    def play(self) -> RunOutcome:
        """All commands at their times."""
        places = {id(each): place for place, each in enumerate(self._score.commands)}
        for asked in sorted(self._score.asked, key=lambda each: each.call_time):
            self._wait_for(asked.call_time - EARLY)
            if isinstance(asked.command, link.ConnectionClosed):
                self._hang_up(asked.command.client)
            else:
                self._send(asked, places[id(asked)])
        self._wait_for(self._score.end + AFTER)
        return self._outcome()

    def _send(self, asked: RecordedCommand, place: int) -> None:
        method, parameters, more = call(asked, self._score.names)
        taken = self._replies.setdefault(place, [])
        self._line(asked.command.client).send(method, parameters, taken.append, more=more)

    def _wait_for(self, moment: float) -> None:
        while (left := moment + self._passage.shift - self._clock.now()) > 0.0:
            self._pump(left)

    def _outcome(self) -> RunOutcome:
        last = self._last or self._status
        return RunOutcome(
            tuple(self._answers()), self._standing.end(), last["state"], last["mode"], bool(last["armed"])
        )

    def _answers(self) -> Iterator[CommandOutcome]:
        for place, asked in enumerate(self._score.commands):
            replies = self._replies.get(place, [])
            error = replies[-1][1] if replies else None
            yield answer(asked.method, [said for said, _, _ in replies], error)

    # ------------------------------------------------------------------------------------- connections

    def _line(self, client: int) -> ReplayConnection:
        if client not in self._lines or not self._lines[client].open:
            self._lines[client] = ReplayConnection(self._sockets / "control.sock")
        return self._lines[client]

    def _hang_up(self, client: int) -> None:
        """Disconnect a client after the replies that it had. Later clients wait for that, too."""
        if client not in self._lines:
            return
        until = self._clock.now() + STAY
        while self._stays(client) and (left := until - self._clock.now()) > 0.0:
            self._pump(left)
        self._lines.pop(client).close()

    def _stays(self, client: int) -> bool:
        heard = {
            asked.command.ticket: not self._replies[place][-1][2]
            for place, asked in enumerate(self._score.commands)
            if isinstance(asked.command, link.Command) and self._replies.get(place)
        }
        return self._lines[client].open and self._score.stays(client, heard)

    def _pump(self, seconds: float) -> None:
        wait([self._watch, *self._lines.values()], seconds)

    def _see(self, reply: Reply) -> None:
        """A status."""
        said, _, _ = reply
        self._status = said["status"]
        self._time = said["time"]
        moment = self._time - self._passage.shift
        if self._passage.running and moment >= self._score.begin and moment <= self._score.end + LAST:
            self._last = self._status
            faults: list[Named] = [(each["code"], each["joint"]) for each in self._status["faults"]]
            self._standing.look(moment - self._score.begin, self._status["state"], faults)
