"""Robots that one Zenoh session reaches: found by their liveliness tokens, all queried at once."""

import time
from collections.abc import Callable

import zenoh

from twind.bridge.fleet.fleet_roster import MOST, UPLINK, FleetRoster
from twind.bridge.fleet.zenoh_robot_queries import ALIVE
from twind.bridge.zenoh.zenoh_keys import ROOT, robot_of
from twind.protocol.strict_json import loads

PATIENCE = 5.0  # s for an answer
QUESTION = f"{ROOT}/*/ask/GetStatus"
GONE = "its uplink ended, or the way to it is lost"


class RemoteRobotPoller:
    """Poller of remote robots: arrivals and departures come by themselves, status on each call of `ask`."""

    def __init__(self, roster: FleetRoster, session: zenoh.Session, tell: Callable[[str], None]) -> None:
        """Watch the tokens of a session, which stays owned by its opener.

        `tell`: receives the robots that are left out, each reason once.
        """
        self._roster = roster
        self._session = session
        self._tell = tell
        self._left_out: set[str] = set()
        self._tokens = session.liveliness().declare_subscriber(
            f"{ROOT}/*/{ALIVE}", self._changed, history=True
        )

    def close(self) -> None:
        """Stop watching the tokens."""
        self._tokens.undeclare()

    def ask(self) -> None:
        """Query all robots at once. Returns at once."""
        begun = time.monotonic()
        self._session.get(
            QUESTION,
            lambda reply: self._answered(reply, begun),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,  # else all answers wait for the last robot
            payload=b'{"joints":true}',
            timeout=PATIENCE,
        )

    def _changed(self, sample: zenoh.Sample) -> None:
        name = self._name(sample.key_expr)
        if name is None:
            return
        if sample.kind == zenoh.SampleKind.DELETE:
            self._roster.mark_lost(name, UPLINK, GONE)
        elif not self._roster.there(name, UPLINK):
            self._leave_out("many", f"more than {MOST} robots: the others are left out")

    def _answered(self, reply: zenoh.Reply, begun: float) -> None:
        """Record an answer; one that cannot be decoded is reported in its robot's row."""
        name = None if reply.ok is None else self._name(reply.ok.key_expr)
        if reply.ok is None or name is None:
            return
        now = time.monotonic()
        try:
            answer = loads(reply.ok.payload.to_bytes())
        except ValueError as error:
            self._roster.odd(name, UPLINK, str(error))
        else:
            self._roster.update_status(name, UPLINK, answer, now, now - begun)

    def _name(self, key: zenoh.KeyExpr) -> str | None:
        try:
            return robot_of(str(key))
        except ValueError as error:
            self._leave_out("name", f"left out, as all of such names: {error}")
            return None

    def _leave_out(self, kind: str, why: str) -> None:
        if kind not in self._left_out:
            self._left_out.add(kind)
            self._tell(why)
