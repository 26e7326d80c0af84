"""Input of the gate: each value as it is at the time of the request, of the target of commands."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import ratings
from tests.support.procedure_rig import NAMES, PERIOD, PLACE, REST, WHY, ProcedureRig
from twind.loop.procedures.gate_input import GateInput
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.gate_types import GateThresholds
from twind.safety.state_machine import RobotEvent

CLIENT = 4
OTHER = 5
NOBODY = np.zeros(len(NAMES), np.bool_)
SIMULATED = np.array([-0.3, 0.2, 0.1])
TROUBLE = Finding(ReasonCode.CALIB_MISMATCH, 2, message="ordered by the test")
BAR = Finding(ReasonCode.SERVO_ALERT, 0, message="ordered by the test")


class Input(ProcedureRig):
    """Live and connected; `CLIENT` holds the lease. A simulation is elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        count = len(NAMES)
        self.robot.simulated = self.state(SIMULATED)
        slow = self.hardware.slow
        slow.temperature = np.array([30.0, 40.0, 50.0])
        slow.voltage = np.full(count, 12.0)
        slow.health_time = self.clock.now() - np.array([0.1, 0.2, 0.3])
        object.__setattr__(self.robot.description, "ratings", ratings(count))
        self.figures: Any = SimpleNamespace(missed_in_a_row=3)
        self.troubles: list[Finding] = []
        self.missed: list[tuple[int, float]] = []
        guard = SimpleNamespace(bars=(), holding=self._holding)
        self.guard = guard
        lease = SimpleNamespace(held_by=lambda client, now: client == CLIENT and now == self.clock.now())
        health = SimpleNamespace(latency=lambda now: now - 99.99, latency_p95=lambda now: now - 99.98)
        parts: Any = SimpleNamespace(thresholds=GateThresholds(), guard=guard, lease=lease, health=health)
        self.gate = GateInput(self, parts, self.figures, lambda: self.troubles)

    def _holding(self, missed: int, period: float) -> tuple[Finding, ...]:
        self.missed.append((missed, period))
        return (WHY,)

    def snapshot(self, client: int = CLIENT) -> Any:
        return self.gate.snapshot(client, self.clock.now())

    def refused(self, client: int = CLIENT, limp: Any = NOBODY) -> list[ReasonCode]:
        return [each.code for each in self.gate.may_arm(client, self.clock.now(), limp=limp).refusals]


@pytest.fixture
def rig() -> Input:
    return Input()


# --------------------------------------------------------------------------------------------- the snapshot


def test_the_lease_counts_for_its_holder_alone(rig: Input) -> None:
    assert rig.snapshot().lease_held
    assert not rig.snapshot(OTHER).lease_held


def test_a_robot_without_a_reference_moves_from_where_it_is_measured(rig: Input) -> None:
    reference = rig.snapshot().reference
    assert reference.position.tolist() == PLACE.tolist()
    assert reference.velocity.tolist() == reference.acceleration.tolist() == [0.0, 0.0, 0.0]
    rig.condition.mode = Mode.SIM
    assert rig.snapshot().reference.position.tolist() == SIMULATED.tolist()


def test_a_held_robot_moves_from_its_last_goal(rig: Input) -> None:
    rig.hold(REST)
    rig.read(position=PLACE)
    found = rig.snapshot()
    assert found.reference is rig.executor.reference
    assert found.reference.position.tolist() == REST.tolist()
    assert (found.state, found.motion) == (RobotState.ARMED, Motion.HOLDING)


def test_the_age_of_a_reading_grows_from_its_tick_to_the_request(rig: Input) -> None:
    rig.read(age=np.array([0.0, 0.02, np.inf]))
    rig.clock.sleep_until(rig.clock.now() + 0.03)
    rig.robot.simulated = rig.state(SIMULATED)
    assert rig.snapshot().age == pytest.approx([0.03, 0.05, np.inf])
    rig.condition.mode = Mode.MIRROR
    assert rig.snapshot().age == pytest.approx([0.0, 0.0, 0.0])


def test_temperature_and_supply_are_as_old_as_their_reading(rig: Input) -> None:
    condition = rig.snapshot().condition
    assert condition.age == pytest.approx([0.1, 0.2, 0.3])
    assert condition.temperature is rig.hardware.slow.temperature
    assert condition.voltage is rig.hardware.slow.voltage
    assert condition.ratings is rig.robot.description.ratings
    assert condition.together == ()


def test_ticks_missed_before_the_request_count_in_live_alone(rig: Input) -> None:
    assert rig.snapshot().holding == (WHY,)
    rig.condition.mode = Mode.MIRROR
    rig.snapshot()
    assert rig.missed == [(3, PERIOD), (0, PERIOD)]


@pytest.mark.parametrize(
    ("torque", "on"),
    [((0, 0, 0), False), ((0, 1, 0), True), ((0, -1, 0), None)],
    ids=["off", "on", "unknown"],
)
def test_torque_of_a_robot_with_a_latch_is_as_it_was_read_back(
    rig: Input, torque: Any, on: bool | None
) -> None:
    rig.found(torque)
    assert rig.snapshot().torque_on is None
    rig.condition.latch(WHY)
    assert rig.snapshot().torque_on is on
    assert rig.snapshot().latched == (WHY.code,)
    rig.condition.acknowledge([WHY.code])
    rig.condition.change(RobotEvent.FAULT)
    assert rig.snapshot().torque_on is on


def test_what_else_prevents_a_motion_is_passed_on(rig: Input) -> None:
    rig.troubles = [TROUBLE]
    rig.guard.bars = (BAR,)
    rig.condition.unreachable = WHY
    limp = np.array([False, True, False])
    rig.torque.leave_limp(limp)
    rig.robot.joints.calibrated = (True, False, True)
    found = rig.snapshot()
    assert (found.mismatches, found.bars, found.unreachable) == ((TROUBLE,), (BAR,), WHY)
    assert found.limp.tolist() == limp.tolist()
    assert found.calibrated.tolist() == [True, False, True]
    assert (found.now, found.mode) == (rig.clock.now(), Mode.LIVE)
    assert (found.latency, found.latency_p95) == pytest.approx((0.01, 0.02))
    assert not found.busy
    rig.gate.busy = True
    assert rig.snapshot().busy


# --------------------------------------------------------------------------------------------- arming


def test_a_robot_that_is_well_may_be_armed(rig: Input) -> None:
    assert rig.gate.judged_since == 0
    assert rig.refused() == []
    assert rig.refused(OTHER) == [ReasonCode.LEASE_MISSING]


def test_arming_is_judged_without_the_limp_joints(rig: Input) -> None:
    rig.hardware.slow.temperature[1] = 80.0
    assert rig.refused() == [ReasonCode.THERMAL_HEADROOM]
    assert rig.refused(limp=np.array([False, True, False])) == []
    assert rig.refused(limp=~NOBODY) == [ReasonCode.NO_JOINTS]


def test_arming_is_judged_by_the_thresholds_in_force(rig: Input) -> None:
    rig.gate.thresholds = GateThresholds(latency_block=0.015)
    assert rig.refused() == [ReasonCode.LATENCY_BLOCK]


def test_no_robot_is_armed_with_a_bus_that_is_not_identified(rig: Input) -> None:
    rig.hardware.connected = False
    verdict = rig.gate.may_arm(CLIENT, rig.clock.now(), limp=NOBODY)
    [finding] = verdict.refusals
    assert (finding.code, finding.message) == (
        ReasonCode.HW_DISCONNECTED,
        "not every bus is open and identified",
    )
    rig.condition.mode = Mode.MIRROR
    assert rig.refused() == [ReasonCode.MODE_DENIES]


def test_gains_that_another_client_tries_prevent_arming(rig: Input) -> None:
    assert rig.gate.foreign_gains(CLIENT) == ()
    rig.gate.gains_tried_by = OTHER
    assert rig.refused() == [ReasonCode.BUSY]
    [finding] = rig.gate.foreign_gains(CLIENT)
    assert "gains that another client tried are in force" in finding.message
    rig.gate.gains_tried_by = CLIENT
    assert rig.refused() == []
