"""Rules SERVO_ALERT to WATCHDOG_TRIPPED: the states that the servos report. Pure."""

from collections.abc import Collection, Iterator, Sequence
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Bools, same, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.guard_types import NOTHING, GuardInput, GuardThresholds, Reaction, RuleResult, hold

ALERT = 0x80  # of a status packet's error byte: a hardware error, whose bits are in register 70
BITS = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
ON_CAN = {1: "not calibrated", 6: "silent to its master", 7: "an error that has no name here"}  # besides
LOST_MASTER = 1 << 6  # on CAN: its watchdog has tripped, and arming clears that
TRIPPED = 255  # value of a device's watchdog register after it has tripped (e-manual, Bus Watchdog)
BARRED = (
    "takes no goals until it is armed anew: its watchdog tripped, or it has none and was silent for 0.1 s "
    "or lost torque; disarm, reset, arm"
)
TORQUE_OFF = "torque reads back off (0) or unknown (-1) while armed"
TORQUE_ON = "torque reads back on (1) or unknown (-1) in a limp joint: does another program write there?"
CLOCK = 32768  # ms: a servo's realtime tick (120) counts up to this, then from 0


def words(bits: int, *, can: bool = False) -> str:
    """Return the names of the bits of a hardware error: register 70 (e-manual, Hardware Error Status).

    A CAN actuator has further ones (`twind_drivers.can.actuator_family`).
    """
    if bits <= 0:  # -1 unknown; 0 was read before the alert
        return "which one was not read yet"
    names = BITS | ON_CAN if can else BITS
    return ", ".join(names.get(bit, f"bit {bit}") for bit in range(bits.bit_length()) if bits >> bit & 1)


class DeviceRules:
    """Rules on device states; memory per joint: torque disagreements in a row, and the last clock reading."""

    def __init__(self, leg: Bools, free: bool, bounds: GuardThresholds, can: Collection[int] = ()) -> None:
        """`leg` (n,): the joint carries the robot.

        `free`: the robot stands freely, so that a limp leg lets it fall.

        `can`: joints with actuators on CAN.
        """
        count = len(leg)
        self._can = can
        self._on_can = np.isin(np.arange(count), list(can))
        self._bounds = bounds
        self._free = free
        self._leg = leg
        self._suspect = False  # one of the next two arrays holds a fault
        self._disagreed = np.zeros(count, np.int64)
        self._unwatched = np.zeros(count, np.bool_)
        self._refreshed = np.full(count, -inf)  # s, readings up to here are judged or do not count
        self._taken = -inf  # s, when this daemon last had no torque on
        self._unclaimed = -inf  # s, when it last neither had torque nor was arming
        self._tick = np.full(count, -1, np.int64)
        self._tick_time = np.full(count, -inf)
        self._seen = self._ticked = self._refreshed.tobytes()  # the two times, as bytes: mostly unchanged
        self._dogs = b""  # the watchdogs, as bytes, and the joints with a tripped one
        self._tripped: list[int] = []

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return the faults of the servos."""
        return NOTHING if self._is_usual(facts) else tuple(self._found(facts))

    def _is_usual(self, facts: GuardInput) -> bool:
        """Check that torque is held, no device reports an error, and no register was read anew."""
        return (
            facts.torque_held
            and facts.torque_settled
            and not (self._suspect or self._tripped or some(facts.alerts))
            and same(facts.health_time, self._ticked)
            and same(facts.status_time, self._seen)
            and same(facts.watchdog, self._dogs)
        )

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        if some(facts.alerts) and facts.mode is not Mode.SIM:
            yield from self._alerts(facts)
        if not same(facts.health_time, self._ticked):
            yield from self._restarts(facts)
        if not facts.torque_ours:
            self._unclaimed = facts.now
        if not facts.torque_held:
            self._taken = facts.now
            self._tripped = []
            self._forget(facts.now)
            return
        fresh = not same(facts.status_time, self._seen)
        if fresh:
            self._refresh(facts)
        if fresh or not same(facts.watchdog, self._dogs):
            self._dogs = facts.watchdog.tobytes()
            tripped = (facts.watchdog == TRIPPED) & (facts.status_time > self._taken)
            self._tripped = np.flatnonzero(tripped).tolist()
        for joint in self._tripped:
            finding = Finding(ReasonCode.WATCHDOG_TRIPPED, joint, message=BARRED)
            yield RuleResult(finding, hold(facts), latches=True)
        yield from self._torque(facts)

    def _rest(self, facts: GuardInput) -> Reaction:
        """Return the reaction of the other joints when one joint may have gone limp."""
        return Reaction.SETTLE if self._free else hold(facts)

    def _limp(self, facts: GuardInput, joint: int) -> Reaction:
        """Return the reaction of the other joints when one is limp.

        Without one leg the robot is falling already.
        """
        return Reaction.DAMP if self._free and self._leg[joint] else self._rest(facts)

    def faulty(self, fault: NDArray[np.signedinteger[Any]]) -> Bools:
        """Return the joints (n,) whose error bits are a hardware error: a lost master is none."""
        found: Bools = (fault > 0) & ~(self._on_can & (fault == LOST_MASTER))
        return found

    def kept_errors(self, fault: NDArray[np.signedinteger[Any]]) -> Bools:
        """Return the joints on CAN (n,) whose last reported error bits are a hardware error.

        Without torque no reading of a RobStride shows whether it has gone. Servos report it in each reading.
        """
        return self._on_can & self.faulty(fault)

    def hardware_error(self, joint: int, bits: int) -> Finding:
        """Return SERVO_ALERT for a joint whose device has these error bits; -1: not read yet."""
        on_can = joint in self._can
        remedy = "find the cause, disarm, then `twindctl reboot BUS ID`"
        message = f"hardware error: {words(bits, can=on_can)}: {remedy}"
        message += ", or switch its power off and on" if on_can else ""
        value, bound = (float(bits), 0.0) if bits > 0 else (None, None)
        return Finding(ReasonCode.SERVO_ALERT, joint, value=value, bound=bound, message=message)

    def _alerts(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield SERVO_ALERT: a hardware error. Without its bits it has no bound; a second report has them."""
        for joint in np.flatnonzero(facts.alerts & ALERT).tolist():
            finding = self.hardware_error(joint, int(facts.fault[joint]))
            if facts.torque_ours:
                off = facts.torque[joint] == 0 and not facts.is_limp(joint)
                shut_down = facts.torque_held and off  # it shut itself down
                reaction = self._limp(facts, joint) if shut_down else self._rest(facts)
                yield RuleResult(finding, reaction, latches=True, bars=True)
            else:
                yield RuleResult(finding, bars=True)

    def _restarts(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield SERVO_REBOOTED for a servo clock that is off and began after its last reading.

        A restart before the arming is no fault, though its clock is read only after it: arming has read back
        and set anew all that a restart loses.
        """
        tick = facts.tick.astype(np.int64)
        started = facts.health_time - 1e-3 * tick  # s, at the latest
        ours = (started >= self._unclaimed - self._bounds.clock_slack) & facts.torque_ours
        for joint in np.flatnonzero(self._restarted(tick, facts)).tolist():
            finding = Finding(
                ReasonCode.SERVO_REBOOTED, joint, value=float(tick[joint]), message=_rebooted("ms up")
            )
            if ours[joint]:
                yield RuleResult(finding, self._limp(facts, joint), latches=True, bars=True)
            else:
                yield RuleResult(finding, bars=True)
        self._tick = tick
        self._tick_time = facts.health_time.copy()
        self._ticked = facts.health_time.tobytes()

    def _restarted(self, tick: np.ndarray[tuple[int], np.dtype[np.int64]], facts: GuardInput) -> Bools:
        """Return joints (n,) whose servo restarted between the last two readings of its clock.

        The clock wraps at 32768 ms, perhaps several times between two readings. After a gap in which its
        drift covers a whole turn, nothing follows from it.
        """
        both_read = (facts.health_time != self._tick_time) & (tick >= 0) & (self._tick >= 0)
        last = np.where(both_read, self._tick_time, 0.0)
        passed = 1e3 * (np.where(both_read, facts.health_time, 0.0) - last)  # ms
        margin = 1e3 * self._bounds.clock_slack + self._bounds.clock_drift * np.abs(passed)
        off = (tick - self._tick - passed + CLOCK / 2) % CLOCK - CLOCK / 2
        right = (np.abs(off) <= margin) & (margin < CLOCK / 2)
        young = tick <= passed + margin
        restarted: Bools = both_read & young & ~right
        return restarted

    def _torque(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield TORQUE_MISMATCH: torque reads off or unknown too often in a row.

        SERVO_REBOOTED: no watchdog.
        """
        if not facts.torque_settled:
            self._forget(facts.now)
        if not self._suspect:
            return
        for joint in np.flatnonzero(self._unwatched).tolist():
            message = _rebooted("is its watchdog, armed before")
            finding = Finding(ReasonCode.SERVO_REBOOTED, joint, value=0.0, message=message)
            yield RuleResult(finding, self._limp(facts, joint), latches=True)
        for joint in np.flatnonzero(self._disagreed >= self._bounds.disagreements).tolist():
            limp = facts.is_limp(joint)
            message = TORQUE_ON if limp else TORQUE_OFF
            value = float(facts.torque[joint])
            bound = 0.0 if limp else 1.0
            finding = Finding(ReasonCode.TORQUE_MISMATCH, joint, value=value, bound=bound, message=message)
            off = facts.torque[joint] == 0
            yield RuleResult(finding, self._limp(facts, joint) if off else self._rest(facts), latches=True)

    def _refresh(self, facts: GuardInput) -> None:
        """Take in new readings: torque that disagrees, and devices without a watchdog."""
        fresh = facts.status_time > self._refreshed
        self._refreshed = np.maximum(self._refreshed, facts.status_time)
        self._seen = facts.status_time.tobytes()
        wrong = facts.torque != 1
        if facts.limp is not None:
            wrong = np.where(facts.limp, facts.torque != 0, wrong)
        unwatched = facts.watchdog == 0
        if self._suspect or some(wrong) or some(unwatched):
            self._disagreed[fresh & ~wrong] = 0
            self._disagreed[fresh & wrong] += 1
            self._unwatched[fresh] = unwatched[fresh]
            self._suspect = some(self._disagreed) or some(self._unwatched)

    def _forget(self, now: float) -> None:
        """Discard earlier readings: they do not describe an armed servo.

        The time decides, not which reading was the last: a status has two halves, and a new first half may
        come with an old second one.
        """
        self._refreshed[:] = now
        if self._suspect:
            self._disagreed[:] = 0
            self._unwatched[:] = False
            self._suspect = False


def _rebooted(how: str) -> str:
    return f"{how}: its servo restarted by itself: check power and cable, disarm, reset, arm"
