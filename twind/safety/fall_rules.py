"""Rule FALLING: a robot on its own feet that no stance can hold any more. Pure.

It falls when its capture point leaves the feet (`capture_point`), or when its base tilts too far. Without
torque of this daemon it may be carried and laid down: nothing is reported, and a tilt only refuses arming.
"""

from collections.abc import Sequence
from math import atan2, hypot, inf, isnan

from twind.robot.attitude import up
from twind.robot.fall_settings import FallReaction, FallSettings, FallState
from twind.robot.finding import Finding, ReasonCode
from twind.safety.capture_point import CapturePoint
from twind.safety.goal_rules import ROUNDING
from twind.safety.guard_types import NOTHING, GuardInput, Reaction, RuleResult, detection_lost, hold

OLD = 0.1  # s: an older reading of the IMU tells no balance
# A smaller lean cannot take the capture point out of the feet: rad of tilt, plus its rate for so many s.
CALM = 0.08
AHEAD = 0.1
REST = 0.5  # rad/s: a fallen robot turns slower ...
REST_FOR = 0.3  # s ... for so long
UPRIGHT_FOR = 1.0  # s inside all thresholds, before a fall counts as over


SILENT = (detection_lost("the IMU gives no reading, so that no fall is detected"),)
UNBALANCED = (detection_lost("a joint has no position, so that only the tilt tells a fall"),)


class FallRules:
    """Rule FALLING; memory: the state of balance, and since when its thresholds are passed."""

    def __init__(self, settings: FallSettings, capture: CapturePoint) -> None:
        self.state = FallState.UNKNOWN
        self.bars: tuple[Finding, ...] = ()  # why arming is refused now; carried by hand this is no event
        self._settings = settings
        self._capture = capture
        self._read = -inf  # s, of the last reading of the IMU
        self._outside_since = inf  # s, since when the capture point is outside ...
        self._upright_since = inf  # ... the robot stands inside all thresholds ...
        self._rest_since = inf  # ... and it does not turn
        self._by_tilt = False  # the fall was detected by its tilt
        self._results: Sequence[RuleResult] = NOTHING

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return FALLING for a robot under torque of this daemon that falls, or fell and does not stand."""
        imu = None if facts.measured is None else facts.measured.imu
        if imu is None or not facts.now - imu.time <= OLD:
            self._lose()
            return SILENT if facts.torque_held else NOTHING
        if imu.time <= self._read:
            return self._results if facts.torque_held else NOTHING
        self._read = imu.time
        x, y, z = up((*imu.quaternion.tolist(),))
        tilt = atan2(hypot(x, y), z)
        if not facts.torque_held:
            self._carried(tilt)
            return NOTHING
        self.bars = ()
        roll, pitch, _ = imu.gyro.tolist()
        rate = hypot(roll, pitch)
        if self.state is FallState.UPRIGHT and tilt + AHEAD * rate <= CALM:
            self._capture.forget()
            self._outside_since = inf
            return NOTHING
        assert facts.measured is not None  # it has an IMU
        self._results = self._judged(facts, tilt, rate, self._capture.margin(facts.measured.position, imu))
        return self._results

    def _judged(self, facts: GuardInput, tilt: float, rate: float, margin: float) -> Sequence[RuleResult]:
        """Return the results of a reading: tilt rad, rate rad/s, margin m."""
        allowed = self._settings
        now = self._read
        outside = margin < -allowed.outside
        self._outside_since = min(self._outside_since, now) if outside else inf
        stands = tilt <= allowed.upright and margin >= 0.0
        self._upright_since = min(self._upright_since, now) if stands else inf
        self._rest_since = min(self._rest_since, now) if rate <= REST else inf
        long = now - self._outside_since >= allowed.seconds - ROUNDING
        if self.state in (FallState.UNKNOWN, FallState.UPRIGHT):
            falls = long or tilt > allowed.tilt
            self.state = (
                FallState.FALLING if falls else FallState.UNKNOWN if isnan(margin) else FallState.UPRIGHT
            )
            self._by_tilt = not long
        elif now - self._upright_since >= UPRIGHT_FOR - ROUNDING:
            self.state = FallState.UPRIGHT
        elif now - self._rest_since >= REST_FOR - ROUNDING:
            self.state = FallState.FALLEN
        if self.state is FallState.UPRIGHT:
            return NOTHING
        if self.state is FallState.UNKNOWN:
            return UNBALANCED
        return (RuleResult(self._finding(tilt, rate, margin), self._reaction(facts), latches=True),)

    def _finding(self, tilt: float, rate: float, margin: float) -> Finding:
        how = f"tilted by {tilt:.2f} rad at {rate:.1f} rad/s"
        if self.state is FallState.FALLEN:
            return _falling(tilt, self._settings.upright, f"rad of tilt: the robot has fallen, {how}")
        if self._by_tilt:
            return _falling(tilt, self._settings.tilt, f"rad of tilt: the robot falls, {how}")
        message = f"m of the capture point outside the feet: the robot falls, {how}"
        return _falling(-margin, self._settings.outside, message)

    def _reaction(self, facts: GuardInput) -> Reaction:
        if self._settings.reaction is FallReaction.HOLD:
            return hold(facts)
        return Reaction.DAMP if self._settings.reaction is FallReaction.SOFT else Reaction.SETTLE

    def _carried(self, tilt: float) -> None:
        """Take a reading without torque: the robot may be carried, laid down and set up."""
        stands = tilt <= self._settings.upright
        self.state = FallState.UPRIGHT if stands else FallState.FALLEN
        self._capture.forget()
        self._outside_since = self._upright_since = self._rest_since = inf
        self._results = NOTHING
        message = "rad of tilt: it is not armed before it stands upright"
        self.bars = () if stands else (_falling(tilt, self._settings.upright, message),)

    def _lose(self) -> None:
        """Note that the IMU gives no reading."""
        if self.state is FallState.UNKNOWN and self.bars:
            return
        self.state = FallState.UNKNOWN
        self._capture.forget()
        self._outside_since = self._upright_since = self._rest_since = inf
        self._results = NOTHING
        message = "the IMU gives no reading, so that no fall is detected: check it, or remove `fall`"
        self.bars = (_falling(None, None, message),)


def _falling(value: float | None, bound: float | None, message: str) -> Finding:
    return Finding(ReasonCode.FALLING, value=value, bound=bound, message=message)
