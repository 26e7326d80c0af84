"""Reports from outside the bytes: states, modes, e-stops, the end of the process."""

from collections.abc import Callable
from typing import Any

STATES = (
    "disconnected",
    "identifying",
    "connected",
    "calibrating",
    "arming",
    "armed",
    "settling",
    "fault",
    "estop",
    "inhibited",
)
MODES = ("sim", "mirror", "live")
GOALS = frozenset(("arming", "armed", "settling", "fault", "estop"))  # in which goals may leave
TORQUE = frozenset(("arming",))  # in which torque may be switched on
AT_REST = frozenset(("connected", "calibrating"))  # in which registers may be set and servos restarted
RESTARTS = AT_REST | {"identifying"}  # in which servos may be restarted: one may be what is not identified
KNOWN = frozenset(("state", "mode", "estop", "killed", "born", "port", "hold", "damp", "aborted", "stopped"))
KNOWN |= {"blind", "talker", "servos"}

STAMPS = 0.005  # s that two clocks' stamps of one thing may differ

Broken = Callable[[str, float, int | None, str], None]


class Words:
    """The daemon as it says it is. Until it says something it is disconnected, and may do nothing (W5)."""

    def __init__(self, broken: Broken, *, writes: bool, hearsay: float) -> None:
        """`hearsay` (s): how much later than the bytes the words may come."""
        self._broken = broken
        self._hearsay = hearsay
        self.state = "disconnected"
        self.mode = "live" if writes else "mirror"
        self.killed = self.stopped = False
        self.open = True
        self.deaf = False  # nobody could have told us anything just now
        self._goal_at = float("-inf")  # s, the last goal packet, or before
        self._owed: list[tuple[float, str, frozenset[str], float, int | None, str]] = []

    @property
    def easy(self) -> bool:
        """Goals may leave, and nothing is owed."""
        return self.state in GOALS and self.mode == "live" and not self._owed and not self.killed

    @property
    def at_rest(self) -> bool:
        return self.state in AT_REST

    @property
    def restarts(self) -> bool:
        return self.state in RESTARTS

    @property
    def silent(self) -> bool:
        """Silence is what is meant, or all there can be; or it is not ours to judge: nobody is armed."""
        return self.killed or self.stopped or not self.open or self.state not in ("arming", "armed")

    def take_report(self, what: str, now: float, **facts: Any) -> None:
        """Raises ValueError for what nobody knows.

        `state` (state=, at=), `mode` (mode=), `estop` (level=, at=), `killed`, `born`: another process begins
        (`at`: when that was, if the words come later);
        `port` (open=): it was opened, or went away; `hold`, `damp`, `aborted`: what the daemon reports of a
        stop; `stopped`: it is kept from running until its next packet; `blind`: the monitor was kept so;
        `talker`: somebody else writes; `servos` (velocity=, trip_delay=, by id) after a kill.
        """
        if what not in KNOWN:
            raise ValueError(f"told {what!r}; known: {', '.join(sorted(KNOWN))}")
        if what == "state":
            if facts["state"] not in STATES:
                raise ValueError(f"state {facts['state']!r}; known: {', '.join(STATES)}")
            self.state = facts["state"]
        elif what == "mode":
            if facts["mode"] not in MODES:
                raise ValueError(f"mode {facts['mode']!r}; known: {', '.join(MODES)}")
            self.mode = facts["mode"]
        elif what == "killed":
            self.killed = True
        elif what == "born":
            self.killed = self.stopped = False
            self.state = "disconnected"
            self.open = True
        elif what == "port":
            self.open = bool(facts["open"])
        elif what == "stopped":
            self.stopped = True
        since = facts.get("at", now if not self._hearsay else float("-inf"))
        named = {self.state, self.mode}
        self._owed = [each for each in self._owed if not named & each[2] or since > each[3] + STAMPS]
        if what == "state" and self.state not in GOALS and "at" in facts:
            if self._goal_at > since + STAMPS:
                self._broken("W5", self._goal_at, None, f"a goal after the state became {self.state}")
            self._goal_at = float("-inf")

    def look(self, now: float) -> None:
        """Words that should have come by now."""
        if self.deaf and self._owed:
            self._owed = [(max(each[0], now + self._hearsay), *each[1:]) for each in self._owed]
        while self._owed and now > self._owed[0][0]:
            _, rule, _, time, id, text = self._owed.pop(0)
            self._broken(rule, time, id, text)

    # --------------------------------------------------------------------------- what needs words

    def may_write(self, now: float, name: str) -> bool:
        """W10: mirror and simulation write nothing. False: it was broken."""
        text = f"{name} in {self.mode}"
        return self.mode == "live" or self._need("W10", frozenset(("live",)), now, None, text)

    def left(self, since: float) -> None:
        """A goal packet has left, at `since` or later."""
        self._goal_at = since

    def goal(self, now: float, id: int) -> None:
        """W5 of a goal packet."""
        if self.state not in GOALS:
            self._need("W5", GOALS, now, id, f"a goal in state {self.state}")

    def torque(self, now: float, id: int) -> None:
        """W5 of torque on."""
        if self.state not in TORQUE:
            self._need("W5", TORQUE, now, id, f"torque on in state {self.state}")

    def _need(self, rule: str, one_of: frozenset[str], now: float, id: int | None, text: str) -> bool:
        if self._hearsay > 0.0:
            self._owed.append((now + self._hearsay, rule, one_of, now, id, text))
            return True
        self._broken(rule, now, id, text)
        return False
