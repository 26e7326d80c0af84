"""Restoring of a servo after an end-stop search, attempt by attempt, on a scripted bus."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PERIOD, BusTask, ProcedureRig
from twind import link
from twind.loop.procedures import homing_restore
from twind.loop.procedures.homing_restore import EndstopSearchRecord, answer, find_end_cause, give_back
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.safety.multiturn import StatedPlace
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError, DeviceRefused, IdentifiedDevice, NoReply, WireRangeError

KNEE = 1
TURN = 4096
REST = 700  # count
WAS = IdentifiedDevice(2, 1020, "XM430-W350", 45, {"drive_mode": 0, "homing_offset": 3}, "a")
REFUSED = DeviceRefused("lower", 2, "Operating Mode (11)", "is locked")
LOST = NoReply("lower", (2,), 0.1)
FOUND = Finding(ReasonCode.LEASE_LOST, message="the lease is gone")


class OneServo:
    """Port, writer and single device of one servo; `errors`: of its attempts in turn, then none."""

    def __init__(self, rig: ProcedureRig) -> None:
        self.rig = rig
        self.errors: list[Exception] = []
        self.attempts: list[float] = []  # s
        self.log: list[str] = []
        self.devices: tuple[IdentifiedDevice, ...] = (WAS,)
        self.identification: Any = None
        self.full = False
        self.writer: Any = self
        self.reader: Any = object()
        self.ticks = 2  # of an attempt

    def begin_single_device(self, id: int, **how: int) -> Any:
        self.log.append("alone")
        if self.errors and type(self.errors[0]) is ValueError:
            self.attempts.append(self.rig.clock.now())
            raise self.errors.pop(0)
        assert (id, how) == (2, {"cap": 20, "profile": 5})
        return self

    def end_single_device(self) -> None:
        self.log.append("all")

    def give_back(self, kept: Any) -> str:
        assert kept == "kept"
        return "give back"

    def run(self, script: str) -> Any:
        self.log.append(script)
        self.attempts.append(self.rig.clock.now())
        task: Any = Attempt(self.ticks)
        task.error = self.errors.pop(0) if self.errors else None
        return task

    def identify(self) -> None:
        self.log.append("identify")
        self.rig.hardware.connected = False


class Attempt(BusTask):
    """A script that is done after some looks."""

    def __init__(self, looks: int) -> None:
        self._looks = looks
        super().__init__()

    @property
    def done(self) -> bool:  # type: ignore[override]
        self._looks -= 1
        return self._looks < 0

    @done.setter
    def done(self, value: bool) -> None: ...


class Turns:
    """Turns of three joints: a place chooses one after `takes` looks."""

    def __init__(self, takes: int = 3) -> None:
        self.takes = takes
        self.places: dict[int, StatedPlace] = {}
        self.against: Finding | None = None
        self.withdrawn: list[Sequence[int]] = []

    def locate(self, joint: int, place: StatedPlace) -> Finding | None:
        self.places[joint] = place
        return self.against

    @property
    def turn_known(self) -> Any:
        self.takes -= bool(self.places)
        return np.array([False, self.takes < 0, False])

    def withdraw(self, joints: Sequence[int]) -> list[int]:
        self.withdrawn.append(joints)
        return []


class Scene:
    """A search that is over, its servo not restored yet; torque is off."""

    def __init__(self, **how: Any) -> None:
        self.rig = ProcedureRig()
        self.servo = OneServo(self.rig)
        self.turns = Turns()
        request: Any = SimpleNamespace(joint=KNEE, port=self.servo, id=2, cap=20, profile=5, turn=TURN)
        command = link.FindStop(ticket=4, client=7, joint=KNEE, side="lower", more=True)
        how = {"over": True, "captures": [10.4, 11.6]} | how
        self.pending = EndstopSearchRecord(command, request, WAS, kept="kept", left="mode 5", **how)
        self.restored = 0
        self.count = REST
        self.heard: Callable[[float], float] = lambda now: now
        self.rig.hardware.readings.raw.heard_at = np.zeros(3)
        self.rig.watched = self.read
        self.rig.condition.change(RobotEvent.CALIBRATE)
        self.rig.book.events.clear()
        self.read()

    def read(self) -> None:
        raw = self.rig.hardware.readings.raw
        raw.ticks[:] = self.count
        raw.heard_at[:] = self.heard(self.rig.clock.now())

    def begin(self) -> None:
        def done() -> None:
            self.restored += 1

        steps = give_back(self.rig, self.pending, self.turns, done)  # type: ignore[arg-type]
        self.rig.procedures.beside(steps)

    def seconds(self, seconds: float) -> None:
        self.rig.ticks(round(seconds / PERIOD))

    @property
    def replies(self) -> list[dict[str, Any]]:
        return [reply.parameters for reply in self.rig.book.replies]

    def codes(self) -> list[str]:
        [reply] = self.replies
        return [each.code for each in reply.get("findings") or ()]

    def events(self) -> list[tuple[str, str]]:
        return [(event.level, event.message) for event in self.rig.book.events]


@pytest.fixture
def scene() -> Scene:
    return Scene()


# ------------------------------------------------------------------------------- when it is tried


def test_a_restored_servo_is_identified_before_the_caller_gets_the_captures(scene: Scene) -> None:
    scene.begin()
    scene.seconds(0.1)
    assert scene.servo.log == ["alone", "all", "give back", "identify"]
    assert scene.restored == 1 and scene.replies == []
    scene.rig.hardware.connected = True
    scene.seconds(0.05)
    assert scene.replies == [{"phase": "found", "progress": 1.0, "ticks": [10, 12]}]
    assert scene.events() == [("info", "knee: its stop is at [10, 12]; torque is off")]
    assert scene.turns.places == {}


def test_nothing_is_written_before_the_search_is_over(scene: Scene) -> None:
    scene.pending.over = False
    scene.begin()
    scene.seconds(5.0)
    assert scene.servo.log == [] and scene.replies == []
    scene.pending.over = True
    scene.seconds(0.1)
    assert scene.restored == 1


def waits(rank: Priority) -> Procedure:
    while True:
        yield


def obstacle(rig: ProcedureRig, servo: OneServo, name: str) -> None:
    if name in Priority.__members__:
        rig.own(Priority[name], lambda: waits(Priority[name]))
    elif name == "armed":
        rig.torque.take_hold(np.ones(3, np.bool_))
    elif name == "energising":
        rig.torque.begin_energising()
    elif name in ("writer", "reader"):
        setattr(servo, name, None)
    elif name == "device":
        servo.devices = (replace(WAS, id=3), replace(WAS, settings={}))
    else:
        setattr(servo, name, True)


@pytest.mark.parametrize(
    "name",
    [
        *(each.name for each in Priority if each is not Priority.SHUTDOWN),
        *("armed", "energising", "writer", "reader", "device", "identification", "full"),
    ],
)
def test_nothing_is_written_while_torque_a_procedure_or_the_bus_forbids_it(scene: Scene, name: str) -> None:
    obstacle(scene.rig, scene.servo, name)
    scene.begin()
    scene.seconds(2.9)
    assert scene.servo.attempts == [] and scene.replies == []
    scene.seconds(0.5)
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH]
    [finding] = scene.replies[0]["findings"]
    assert finding.joint == KNEE and finding.message == (
        "its mode and settings are not as they were: torque or bus do not allow it yet; it is tried again "
        "until they do; it is left with mode 5"
    )
    assert scene.servo.attempts == [] and scene.restored == 0


def test_an_ending_daemon_restores_it_and_replies_at_once(scene: Scene) -> None:
    obstacle(scene.rig, scene.servo, "SHUTDOWN")
    scene.rig.condition.stop_wanted = True
    scene.begin()
    while not scene.restored:
        scene.rig.tick()
    assert not scene.rig.hardware.connected and len(scene.replies) == 1


def test_a_bus_that_is_not_identified_in_time_delays_the_reply_by_three_seconds_at_most(scene: Scene) -> None:
    scene.begin()
    scene.seconds(2.95)
    assert scene.replies == []
    scene.seconds(0.1)
    assert scene.codes() == []


def test_a_late_restoring_is_reported_to_a_caller_that_was_answered(scene: Scene) -> None:
    obstacle(scene.rig, scene.servo, "energising")
    scene.begin()
    scene.seconds(4.0)
    scene.rig.torque.confirm_off()
    scene.seconds(0.5)
    assert scene.restored == 1 and len(scene.replies) == 1
    assert scene.events()[-1] == ("info", "knee: its mode and settings are as they were")
    assert scene.servo.log[-1] == "identify"


# ------------------------------------------------------------------------------- what ends it


@pytest.mark.parametrize("error", [REFUSED, ValueError("no mode 5"), KeyError("led")])
def test_three_refusals_end_the_restoring(scene: Scene, error: Exception) -> None:
    scene.servo.errors = [error] * 5
    scene.begin()
    scene.seconds(2.0)
    first, second, third = scene.servo.attempts
    assert second - first >= 0.25 and third - second >= 0.25
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH] and scene.restored == 1
    assert str(error) in scene.replies[0]["findings"][0].message
    assert scene.replies[0]["phase"] == "failed" and "ticks" not in scene.replies[0]
    [(level, text), (_, last)] = scene.events()
    assert level == "error" and text.startswith("knee: its mode and settings are not as they were: ")
    assert last.startswith("knee: its stop was not found: ")


def test_two_refusals_do_not_end_it(scene: Scene) -> None:
    scene.servo.errors = [REFUSED] * 2
    scene.begin()
    scene.seconds(1.0)
    assert len(scene.servo.attempts) == 3 and scene.restored == 1
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == []


@pytest.mark.parametrize("error", [LOST, BusError("dropped")])
def test_attempts_that_were_cut_short_are_repeated_without_end(scene: Scene, error: BusError) -> None:
    scene.servo.errors = [error] * 30
    scene.begin()
    scene.seconds(8.0)
    assert scene.restored == 0 and len(scene.servo.attempts) == 30
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH]
    scene.seconds(0.5)
    assert scene.restored == 1


def test_bytes_that_may_not_leave_latch_and_end_it(scene: Scene) -> None:
    scene.servo.errors = [WireRangeError("lower", 2, 9, 0, 4)]
    scene.begin()
    scene.seconds(0.1)
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.WIRE_CLAMP, ReasonCode.DEVICE_MISMATCH]
    clamp, left = scene.replies[0]["findings"]
    assert (clamp.joint, clamp.value) == (KNEE, 9.0) and "packet not sent" in clamp.message
    assert "packet not sent" in left.message and scene.restored == 1
    assert ReasonCode.WIRE_CLAMP in scene.rig.condition.latches


@pytest.mark.parametrize(
    ("other", "text"),
    [
        ({"model_number": 1030}, "model was 1020, reads 1030"),
        ({"firmware": 44}, "firmware was 45, reads 44"),
        ({"unique_id": "b"}, "unique id was a, reads b"),
        ({"settings": {"drive_mode": 1, "homing_offset": 3}}, "drive_mode was 0, reads 1"),
        ({"settings": {"drive_mode": 0, "homing_offset": 4}}, "homing_offset was 3, reads 4"),
    ],
)
def test_another_device_with_its_id_gets_nothing(scene: Scene, other: Any, text: str) -> None:
    scene.servo.devices = (replace(WAS, **other),)
    scene.begin()
    scene.seconds(0.1)
    assert scene.servo.log == ["identify"] and scene.restored == 1
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    [finding] = scene.replies[0]["findings"]
    assert f"another device has its id now ({text}): nothing was written" in finding.message


def test_findings_of_the_search_precede_those_of_the_restoring() -> None:
    scene = Scene(findings=(FOUND,))
    scene.servo.errors = [REFUSED] * 3
    scene.begin()
    scene.seconds(1.0)
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.LEASE_LOST, ReasonCode.DEVICE_MISMATCH]
    assert scene.events()[-1] == ("warning", "knee: its stop was not found: the lease is gone")


# ------------------------------------------------------------------------------- the turn of its rest


def resting(**how: Any) -> Scene:
    """A search that determined the turn; its bus is identified at once."""
    scene = Scene(rest=REST, **how)
    scene.servo.identify = lambda: scene.servo.log.append("identify")  # type: ignore[method-assign]
    return scene


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_a_joint_that_stays_at_its_rest_keeps_the_turn_that_was_found(turns: int) -> None:
    scene = resting()
    scene.count = REST + turns * TURN + 32
    scene.begin()
    scene.seconds(0.5)
    assert scene.turns.places == {KNEE: StatedPlace(REST, 32, "the end-stop search")}
    assert scene.codes() == [] and scene.turns.withdrawn == [[KNEE]]


def moved_a_turn(scene: Scene) -> None:
    for step in range(1, 9):
        scene.count = REST + step * TURN // 8
        scene.rig.tick()


def silent(scene: Scene) -> None:
    last = scene.rig.clock.now()
    scene.heard = lambda _: last
    scene.seconds(0.12)
    scene.heard = lambda now: now


@pytest.mark.parametrize("leaves", [moved_a_turn, silent])
def test_a_joint_that_left_its_rest_before_the_restoring_gets_no_turn_although_its_count_fits_again(
    leaves: Callable[[Scene], None],
) -> None:
    scene = resting()
    scene.servo.errors = [LOST] * 3
    scene.begin()
    scene.seconds(0.1)
    leaves(scene)
    scene.seconds(2.0)
    assert scene.restored == 1 and scene.turns.places == {}
    assert scene.codes() == [ReasonCode.CALIB_MISMATCH]
    [finding] = scene.replies[0]["findings"]
    assert finding.joint == KNEE and "its turn stays unknown" in finding.message


def test_a_joint_whose_last_reading_is_of_the_last_tenth_of_a_second_rests() -> None:
    scene = resting()
    scene.heard = lambda now: now - 0.099
    scene.begin()
    scene.seconds(0.5)
    assert scene.codes() == []


def test_a_place_that_contradicts_the_readings_gives_no_turn() -> None:
    scene = resting()
    scene.turns.against = Finding(ReasonCode.CALIB_MISMATCH, KNEE, message="stands aside")
    scene.begin()
    scene.seconds(0.1)
    assert scene.replies[0]["findings"] == [scene.turns.against]
    assert scene.turns.withdrawn == [[KNEE]]


@pytest.mark.parametrize(("takes", "codes"), [(24, []), (60, [ReasonCode.CALIB_MISMATCH])])
def test_readings_have_a_quarter_of_a_second_to_choose_the_turn(takes: int, codes: list[str]) -> None:
    scene = resting()
    scene.turns.takes = takes
    scene.begin()
    scene.seconds(1.0)
    assert scene.codes() == codes and scene.turns.withdrawn == [[KNEE]]


@pytest.mark.parametrize("why", ["refused", "answered"])
def test_no_turn_is_chosen_for_a_servo_that_is_not_restored_or_a_caller_that_was_answered(why: str) -> None:
    scene = resting(answered=why == "answered")
    scene.servo.errors = [REFUSED] * (3 if why == "refused" else 0)
    scene.begin()
    scene.seconds(1.0)
    assert scene.restored == 1 and scene.turns.places == {}


# ------------------------------------------------------------------------------- what is reported


def test_a_search_is_answered_once(scene: Scene) -> None:
    answer(scene.rig, scene.pending)
    answer(scene.rig, scene.pending, FOUND)
    assert scene.codes() == []


def test_a_daemon_that_ends_reports_what_is_left(scene: Scene) -> None:
    homing_restore.report_pending_restore(scene.rig, scene.pending)
    [finding] = scene.replies[0]["findings"]
    assert finding.code == ReasonCode.DEVICE_MISMATCH
    assert finding.message == (
        "its mode and settings are not as they were: the daemon ends; it is left with mode 5"
    )
    assert scene.events()[0] == ("error", f"knee: {finding.message}")


def test_the_cause_of_an_end_from_outside_is_a_latch_the_end_of_the_daemon_or_the_state(scene: Scene) -> None:
    condition = scene.rig.condition
    assert find_end_cause(scene.rig).message == "the robot went to calibrating: disarmed, or a bus lost"
    condition.stop_wanted = True
    assert find_end_cause(scene.rig) == Finding(ReasonCode.NOT_ARMED, message="the daemon ends")
    condition.latch(FOUND)
    assert find_end_cause(scene.rig) == FOUND
