"""Clients, faults and deaths in random order: hypothesis chooses, `Invariants` judges after every tick."""

import tempfile
from collections import Counter
from pathlib import Path
from typing import ClassVar

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tests.proof.model.world import JOINT, World
from twind import link
from twind.robot.modes import Mode

# s before the same is said again of a joint: armed, and not armed
QUIET = 1.0
QUIET_WARNING = 10.0
WHO = st.integers(0, 2)
PLACES = st.sampled_from([-0.4, -0.1, 0.0, 0.1, 0.3])
PAUSES = st.sampled_from([0.01, 0.02, 0.05, 0.1, 0.3, 1.1])
LONG = st.sampled_from([0.15, 0.3, 0.6, 1.5])
MODES = st.sampled_from([Mode.LIVE, Mode.LIVE, Mode.LIVE, Mode.MIRROR, Mode.SIM])


class Daemon(RuleBasedStateMachine):
    """Three clients at most, one daemon at a time. `counted`: what happened in all lives so far."""

    counted: ClassVar[Counter[str]] = Counter()

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="twind-model-")

    @initialize(mode=MODES)
    def begin(self, mode: Mode) -> None:
        self.world = World(Path(self._folder.name), mode)
        self.world.pass_(0.4)

    def teardown(self) -> None:
        """Everything comes to an end: nobody is left waiting, and the history makes sense."""
        try:
            if hasattr(self, "world") and self.world.invariants.sound:
                self.world.heal()
                self._stop_all()
                self.world.invariants.end()
                self._count()
        finally:
            if hasattr(self, "world"):
                self.world.close()
            self._folder.cleanup()

    def _stop_all(self) -> None:
        client = self.world.connect_client()
        self.world.begin(client, link.Cancel)
        self.world.pass_(1.0)
        self.world.begin(client, link.Disarm)
        self.world.pass_(8.0)

    def _count(self) -> None:
        history = self.world.history
        self.counted.update(f"call {op.name}: {op.result}" for op in history.ops)
        self.counted.update(f"motion {op.fate}" for op in history.ops if op.fate)
        self.counted["ticks"] += self.world.invariants.ticks
        self.counted["ticks armed"] += self.world.invariants.armed_ticks
        self.counted["lives of a daemon"] += self.world.lives
        self.counted["deaths of a daemon or a front"] += len(history.deaths)
        self.counted["faults reported in time"] += self.world.invariants.reported

    def client(self, who: int) -> int:
        """One of those that are connected; a new one where there are too few."""
        while len(self.world.clients) <= who:
            self.world.connect_client()
        return self.world.clients[who]

    @property
    def alive(self) -> bool:
        return self.world.front.socket is not None

    # ----------------------------------------------------------------------- clients

    @rule(who=WHO)
    def disconnect(self, who: int) -> None:
        self.world.disconnect(self.client(who))
        self.world.pass_(0.01)

    @rule(who=WHO, take=st.booleans())
    def acquire(self, who: int, take: bool) -> None:
        self.world.begin(self.client(who), link.AcquireLease, take=take)
        self.world.pass_(0.01)

    @rule(first=WHO, second=WHO, take=st.booleans())
    def acquire_at_once(self, first: int, second: int, take: bool) -> None:
        one = self.client(first)
        other = self.client(second)
        self.world.begin(one, link.AcquireLease)
        self.world.begin(other, link.AcquireLease, take=take)
        self.world.pass_(0.01)

    @rule(who=WHO)
    def renew(self, who: int) -> None:
        self.world.begin(self.client(who), link.RenewLease)
        self.world.pass_(0.01)

    @rule(who=WHO)
    def release(self, who: int) -> None:
        self.world.begin(self.client(who), link.ReleaseLease)
        self.world.pass_(0.01)

    @rule(who=WHO, wait=st.sampled_from([0.05, 1.5]))
    def arm(self, who: int, wait: float) -> None:
        client = self.client(who)
        before = self.world.register("torque_enable").astype(bool).copy()
        self.world.begin(client, link.AcquireLease)
        alone = (
            self.world.loop.condition.state != "arming"
        )  # another who arms may succeed where this one is refused
        op = self.world.begin(client, link.Arm)
        self.world.pass_(wait)
        if alone and op.result and op.result != "lost" and wait > 1.0 and not self.world.faults:
            self.world.invariants.armed(before, op.result)

    @rule(who=WHO, still=st.booleans())
    def ready(self, who: int, still: bool) -> None:
        """All that it takes to be armed, from wherever the robot is; then a motion, so that there is one."""
        client = self.client(who)
        if self.world.loop.condition.latches:
            self.world.begin(client, link.Disarm)
            self.world.pass_(2.0)
            self.world.begin(client, link.Reset)
            self.world.pass_(0.1)
        self.world.begin(client, link.SetMode, mode="live")
        self.world.pass_(0.3)
        self.world.begin(client, link.AcquireLease, take=True)
        self.world.begin(client, link.Arm)
        self.world.pass_(0.6)
        if not still:
            self.world.begin(client, link.AcquireLease)
            self.world.begin_motion(client, 0.4, 3.0, more=True)
            self.world.pass_(0.3)

    @rule(who=WHO, wait=st.sampled_from([0.05, 2.0]))
    def disarm(self, who: int, wait: float) -> None:
        self.world.begin(self.client(who), link.Disarm)
        self.world.pass_(wait)

    @rule(who=WHO, place=PLACES, seconds=st.sampled_from([0.5, 1.0, 3.0]), more=st.booleans(), wait=PAUSES)
    def submit(self, who: int, place: float, seconds: float, more: bool, wait: float) -> None:
        client = self.client(who)
        self.world.begin_motion(client, place, seconds, more=more)
        self.world.pass_(wait)

    @rule(who=WHO, place=PLACES)
    def move(self, who: int, place: float) -> None:
        """A motion with all that goes before it, and to its end if nothing comes between."""
        client = self.client(who)
        self.world.begin(client, link.AcquireLease)
        if self.world.loop.condition.state == "connected" and self.world.loop.condition.mode is Mode.LIVE:
            self.world.begin(client, link.Arm)
            self.world.pass_(0.6)
            self.world.begin(client, link.AcquireLease)
        self.world.pass_(0.01)
        op = self.world.begin_motion(client, place, 0.8, more=True)
        self.world.pass_(1.2)
        if op.fate == "succeeded" and self.world.loop.condition.mode is Mode.LIVE and not self.world.faults:
            joint = self.world.names.index(JOINT)
            assert abs(self.world.truth[joint] - place) < 0.02, "succeeded, and the joint is not there"

    @rule(who=WHO, place=PLACES, count=st.integers(1, 12))
    def stream(self, who: int, place: float, count: int) -> None:
        client = self.client(who)
        joint = self.world.names.index(JOINT)
        for _ in range(count):
            self.world.begin(client, link.Setpoint, joints=[joint], positions=[place], allow_clamp=True)
            self.world.pass_(0.03)

    @rule(who=WHO)
    def cancel(self, who: int) -> None:
        self.world.begin(self.client(who), link.Cancel)
        self.world.pass_(0.05)

    @rule(who=WHO, level=st.sampled_from(["settle", "cut"]), more=st.booleans(), wait=PAUSES)
    def estop(self, who: int, level: str, more: bool, wait: float) -> None:
        self.world.begin(self.client(who), link.EStop, level=level, more=more)
        self.world.pass_(wait)

    @rule(who=WHO)
    def reset(self, who: int) -> None:
        self.world.begin(self.client(who), link.Reset)
        self.world.pass_(0.05)

    @rule(who=WHO, mode=MODES)
    def set_mode(self, who: int, mode: Mode) -> None:
        self.world.begin(self.client(who), link.SetMode, mode=mode.value)
        self.world.pass_(0.3)

    # ----------------------------------------------------------------------- faults

    def _old(self) -> bool:
        """Something can have happened since the last death."""
        deaths = self.world.history.deaths
        return not deaths or self.world.clock.now() - deaths[-1] > 6.0

    def _reads(self) -> bool:
        loop = self.world.loop
        heard = bool(
            (loop.robot.measured.age < 0.05).all()
        )  # who is silent already is told of no second time
        return (
            loop.condition.mode is not Mode.SIM
            and loop.hardware.connected
            and heard
            and not self.world.faults
        )

    @precondition(lambda self: self._reads())
    @rule(id=st.integers(1, 24), seconds=st.sampled_from([0.05, 0.3, 1.5]))
    def silence(self, id: int, seconds: float) -> None:
        """A wire that comes off: told after 100 ms and two ticks (row 10), where commands go to the robot."""
        quiet = QUIET if self.world.loop.torque.armed else QUIET_WARNING
        live = self.world.loop.condition.mode is Mode.LIVE
        told = live and seconds > 0.2 and not self.world.invariants.is_reported("STATE_STALE", quiet)
        codes = {"STATE_STALE"} if told else set()
        self.world.order("silence", codes, 0.15, id=id)
        self.world.pass_(seconds)
        self.world.heal()
        self.world.pass_(0.1)

    @precondition(lambda self: self._reads())
    @rule(seconds=st.sampled_from([0.05, 0.5, 1.5]))
    def unplug(self, seconds: float) -> None:
        """The adapter (row 1): told within 50 ms."""
        self.world.order("unplug", {"PORT_LOST"}, 0.05)
        self.world.pass_(seconds)
        self.world.heal()
        self.world.pass_(1.0)

    @precondition(lambda self: self._reads() and self.world.loop.torque.armed)
    @rule(id=st.integers(1, 24))
    def brown_out(self, id: int) -> None:
        """One servo begins anew (row 13): told within its refresh and two ticks."""
        told = {"SERVO_REBOOTED", "TORQUE_MISMATCH", "STATE_STALE"}
        self.world.order("brown_out", told, 0.3, id=id)
        self.world.pass_(0.5)

    # ----------------------------------------------------------------------- deaths and time

    @precondition(lambda self: self.alive and self._old())
    @rule()
    def kill_front(self) -> None:
        self.world.kill_front()

    @precondition(lambda self: self._old())
    @rule(mode=MODES, pause=LONG)
    def kill_daemon(self, mode: Mode, pause: float) -> None:
        self.world.kill_daemon(mode, pause)
        self.world.pass_(0.7)

    @rule(seconds=PAUSES)
    def wait(self, seconds: float) -> None:
        self.world.pass_(seconds)

    @invariant()
    def every_call_ends(self) -> None:
        if hasattr(self, "world"):
            from tests.proof.model.invariants import PATIENCE

            assert not self.world.history.unanswered(self.world.clock.now(), PATIENCE)
