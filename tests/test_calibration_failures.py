"""What goes wrong with a calibration, planted in virtual servos: the daemon names it, and nothing moves.

Each of the fourteen is planted between a calibration and the next start, or in mid-run: no goal leaves that
would turn a shaft, and torque is off at the end. What no reading can show (a swapped servo whose zero is near
the old one, exchanged twins, a wrong sign) is for `twindctl calibrate prove` (tests/test_proving_servos.py).
Of files that are half written tests/test_saving.py tells.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eeprom import calibrate, calibrated
from rig import Rig

from twind import link
from twind.config.robot_file import load_robot
from twind.robot.modes import State
from twind.virtual.specimen import calibration, specimen
from twind.virtual.truth import JointTruth, Truth

KNEE = "l_knee"
TURN = 4096


class Planted(Rig):
    """A robot that was calibrated as `before` and is found as `found`. Every tick is watched."""

    def __init__(
        self,
        before: Mapping[str, JointTruth],
        found: Mapping[str, JointTruth],
        robot: str = "h24",
        **how: Any,
    ) -> None:
        self.energised: set[str] = set()  # joints that had torque at any tick
        self.moved = 0.0  # ticks, the furthest that any shaft was from where it began
        self._began: np.ndarray | None = None
        then = calibration(specimen(load_robot(robot), truth=Truth(before)))
        super().__init__(robot, truth=Truth(found), calibrated=then, **how)

    def ticks(self, count: int) -> None:
        """Let `count` ticks pass, looking after each."""
        for _ in range(count):
            super().ticks(1)
            self.look()

    def look(self) -> None:
        """Who has torque, and who has moved?"""
        on = self.register("torque_enable") != 0
        self.energised |= {self.names[row] for row in np.flatnonzero(on)}
        if self._began is None:
            self._began = self.counts
        self.moved = max(self.moved, float(np.abs(self.counts - self._began).max()))

    def hand(self, **pose: float) -> None:
        """Somebody takes limp joints there, and lets go of them."""
        faults = self.virtual["main"].faults
        faults.hand(pose=pose, speed=3.0)
        self.seconds(1.5)
        faults.hand(off=True)
        self._began, self.moved = None, 0.0

    def id_of(self, joint: str) -> int:
        return self.robot.joints[self.names.index(joint)].id

    def refused(self, *, ticks: int = 150) -> list[tuple[str, str, str]]:
        """Code, joint and words of all that the daemon has against torque, after it was asked for it.

        Nobody had torque meanwhile, and nothing moved.
        """
        self.ticks(ticks)
        self.call(link.AcquireLease)
        reply = self.call(link.Arm)
        assert reply.error is not None, "armed"
        self.ticks(20)
        assert not self.loop.armed
        assert self.energised == set(), "torque was on"
        assert self.moved <= 1.0, "something moved"
        return self.said(reply.parameters.get("findings", ()))

    def said(self, findings: Any = ()) -> list[tuple[str, str, str]]:
        """Of a reply, and of every event so far."""
        found = [(str(each["code"]), each["joint"], each["message"]) for each in findings]
        for event in self.events():
            found += [(str(each.code), each.joint, each.message) for each in event.findings]
        return [(code, "" if at is None else self.names[at], text) for code, at, text in found]


def names_it(said: list[tuple[str, str, str]], code: str, joint: str, *words: str) -> bool:
    """Does anything that was said name all that?"""
    return any((kind, at) == (code, joint) and all(word in text for word in words) for kind, at, text in said)


@pytest.fixture(scope="module")
def floating(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of an h24 whose left knee is in extended position mode."""
    built_in = load_robot("h24")
    text = built_in.path.read_text().replace("mjcf: h24.xml", f"mjcf: {built_in.mjcf_path}")
    head, _, rest = text.partition(f"  {KNEE}:")
    text = f"{head}  {KNEE}:{rest.replace('{', '{mode: extended_position, ', 1)}"
    path: Path = tmp_path_factory.mktemp("floating") / "h24.yaml"
    path.write_text(text)
    return str(path)


@pytest.fixture
def plant() -> Iterator[Any]:
    """Makes planted robots, and puts them away."""
    made: list[Planted] = []

    def one(before: JointTruth, found: JointTruth, robot: str = "h24", **how: Any) -> Planted:
        made.append(Planted({KNEE: before}, {KNEE: found}, robot, **how))
        return made[-1]

    yield one
    for each in made:
        each.close()


PLAIN = JointTruth()
OPEN = {"min_position_limit": 0, "max_position_limit": 4095}  # as delivered: no fingerprint


# ------------------------------------------------------------------- 1: offsets beyond what counts


@pytest.mark.parametrize("offset", [1025, -1025, 2900])
def test_an_offset_that_position_mode_ignores_is_refused_by_register_and_value(
    plant: Any, offset: int
) -> None:
    said = plant(PLAIN, JointTruth(homing_offset=offset)).refused()
    assert names_it(said, "DEVICE_MISMATCH", KNEE, "homing_offset (20)", str(offset), "1024")


def test_an_offset_that_fell_back_to_0_is_refused_with_what_it_was(plant: Any) -> None:
    before, found = JointTruth(homing_offset=1000), JointTruth(homing_offset=2900, forgets_offset=True)
    rig = plant(before, found)
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "homing_offset is 0, was 1000")


# ------------------------------------------------------------------- 2: the jump at torque-on


def test_a_count_that_will_fall_a_turn_at_torque_on_is_expected_to_and_nothing_jumps(plant: Any) -> None:
    """The forum's case: a goal of what is read without torque would be a full turn."""
    truth = JointTruth(zero_ticks=700, homing_offset=-512, registers=OPEN)
    rig = plant(truth, replace(truth, turns=1))
    rig.connect()
    row = rig.names.index(KNEE)
    assert int(rig.loop.hardware.readings.raw.ticks[row]) == 700 - 512 + TURN, "beyond every goal it takes"
    rig.arm()
    rig.seconds(0.5)
    assert rig.virtual["main"].servos["goal_position"][row] == 700 - 512
    assert int(rig.loop.hardware.readings.raw.ticks[row]) == 700 - 512
    assert rig.moved <= 2.0


def test_beyond_the_count_at_which_it_would_fall_a_joint_gets_no_torque(plant: Any) -> None:
    """Offset -512: from 3584 on, torque-on would take a turn off, and no goal goes there."""
    truth = JointTruth(zero_ticks=TURN - 60, homing_offset=-512, registers=OPEN)
    rig = plant(truth, truth)
    rig.connect()
    rig.hand(l_knee=0.3)
    assert int(rig.loop.hardware.readings.raw.ticks[rig.names.index(KNEE)]) > 3584
    assert names_it(rig.refused(), "OUT_OF_LIMIT", KNEE, "move it inside by hand")


def test_a_count_that_jumps_at_torque_on_all_the_same_loses_it_again(
    plant: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A firmware that counts otherwise than the manual says."""
    rig = plant(PLAIN, PLAIN)
    power, row = rig.virtual["main"].servos.power, rig.names.index(KNEE)
    collapse = power.collapse

    def odd(at: int, *, slip: int = 0) -> None:
        collapse(at, slip=slip)
        if at == row:
            power.wind(at, 1)

    rig.connect()
    monkeypatch.setattr(power, "collapse", odd)
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error == "Refused"
    rig.seconds(0.5)
    assert names_it(rig.said(reply.parameters["findings"]), "ARM_FAILED", KNEE, "jumped at torque-on")
    assert (rig.register("torque_enable") == 0).all()
    assert rig.loop.state is State.CONNECTED


# ------------------------------------------------------------------- 3, 4: turns that are lost or found


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize("zero", [2048, 4090, 20])
def test_whatever_turn_a_joint_wakes_up_on_its_angle_is_the_same(
    plant: Any, floating: str, turns: int, zero: int
) -> None:
    """Extended mode; also where the travel crosses the encoder's seam."""
    rig = plant(JointTruth(zero_ticks=zero), JointTruth(zero_ticks=zero, turns=turns), floating)
    rig.connect()
    assert rig.loop.measured.position == pytest.approx(rig.truth, abs=0.01)
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


def test_a_joint_that_is_on_no_turn_of_its_travel_is_refused(plant: Any, floating: str) -> None:
    rig = plant(PLAIN, JointTruth(zero_ticks=specimen(load_robot("h24")).zeros[KNEE] + 2000), floating)
    assert names_it(
        rig.refused(), "CALIB_MISMATCH", KNEE, "neither that nor a turn beside it is in its travel"
    )


def test_a_limp_joint_that_restarts_is_where_it_was_and_is_verified_anew(plant: Any, floating: str) -> None:
    """Its count begins at one turn again."""
    rig = plant(JointTruth(zero_ticks=2048), JointTruth(zero_ticks=2048, turns=1), floating)
    rig.connect()
    row = rig.names.index(KNEE)
    rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
    verified = []
    for _ in range(300):
        rig.ticks(1)
        verified.append(bool(rig.loop.identity.verified.joints[row]))
    assert verified[0] and not all(verified) and verified[-1]
    assert rig.loop.measured.position == pytest.approx(rig.truth, abs=0.01)
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


def test_a_boot_one_tick_beside_the_seam_makes_no_turn(plant: Any, floating: str) -> None:
    """Near tick 0 the count comes back a turn away, or not, by the noise of each boot."""
    assert load_robot("h24").poses["rest"][KNEE] == 0.0
    truth = JointTruth(zero_ticks=0, seam_seed=0)
    rig = plant(truth, truth, floating)
    rig.connect()
    row, seen = rig.names.index(KNEE), set()
    for _ in range(4):
        rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
        rig.seconds(0.7)
        assert rig.loop.state is State.CONNECTED
        seen.add(int(rig.loop.hardware.readings.raw.ticks[row]) // TURN)
        assert rig.loop.measured.position == pytest.approx(rig.truth, abs=0.01)
    assert len(seen) == 2, "both sides of the seam were seen"
    rig.arm()
    rig.seconds(0.3)
    assert rig.moved <= 2.0


# ------------------------------------------------------------------- 5: EEPROM under torque


def test_eeprom_is_not_written_under_torque_that_somebody_else_switched_on(plant: Any) -> None:
    """The daemon cannot know it yet: the servo refuses, that is told, and nothing is half written."""
    rig = plant(PLAIN, PLAIN)
    rig.connect()
    calibrate(rig)
    servos, row = rig.virtual["main"].servos, rig.names.index(KNEE)
    servos.torque(row, True)
    servos.changed()
    before = servos.memory.raw[row, :64].copy()
    reply = rig.call(link.WriteRegister, bus="main", id=rig.id_of(KNEE), name="homing_offset", value=77)
    assert reply.error is not None and "writable only while torque is off" in str(reply.parameters), reply
    assert (servos.memory.raw[row, :64] == before).all()
    servos.torque(row, False)
    servos.changed()
    calibrated(rig)


# ------------------------------------------------------------------- 6, 7: other servos than before


def test_a_swapped_servo_is_refused_by_its_tag(plant: Any) -> None:
    rig = plant(JointTruth(tag=613), JointTruth(tag=10))
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "moving_threshold (24) is 10", "613")


def test_a_swapped_servo_without_a_tag_is_refused_by_its_travel(plant: Any) -> None:
    """Same id, same model, same registers, another zero."""
    rig = plant(JointTruth(zero_ticks=1700, registers=OPEN), JointTruth(zero_ticks=700, registers=OPEN))
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "travel")


def test_exchanged_ids_are_refused_where_the_zeros_are_apart() -> None:
    left, right = (JointTruth(zero_ticks=zero, registers=OPEN) for zero in (1700, 3600))
    apart = {KNEE: left, "r_knee": right}
    rig = Planted(apart, apart | {KNEE: replace(left, swapped_with="r_knee")})
    said = rig.refused()
    assert any(names_it(said, "CALIB_MISMATCH", joint, "travel") for joint in (KNEE, "r_knee"))
    rig.close()


# ------------------------------------------------------------------- 8: travel across the seam


@pytest.mark.parametrize("turns", [0, 1])
def test_a_joint_moves_across_the_seam_of_its_encoder(plant: Any, floating: str, turns: int) -> None:
    truth = JointTruth(zero_ticks=4000, turns=turns)
    rig = plant(truth, truth, floating)
    entry = rig.calibration.by_name[KNEE]
    assert entry.seam_margin_ticks == 0
    rig.arm()
    row = rig.names.index(KNEE)
    before, steps = rig.loop.measured.position[row], []
    rig.submit(rig.path(KNEE, [0.6], [1.0]))
    for _ in range(160):
        rig.ticks(1)
        steps.append(float(rig.loop.measured.position[row] - before))
        before = rig.loop.measured.position[row]
    assert rig.truth[row] == pytest.approx(0.6, abs=0.01)
    assert np.abs(steps).max() < 0.05, "no step of a turn"


# ------------------------------------------------------------------- 9: a reverse bit, and its offset


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (JointTruth(drive_mode=1), "drive_mode is 1, was 0"),
        (JointTruth(homing_offset=300), "homing_offset is 300, was 0"),
        (JointTruth(drive_mode=1, homing_offset=300), "drive_mode is 1, was 0"),
        (JointTruth(registers={"max_position_limit": 4000}), "max_position_limit is 4000"),
    ],
)
def test_settings_that_are_not_those_of_the_calibration_are_refused(
    plant: Any, found: JointTruth, words: str
) -> None:
    assert names_it(plant(PLAIN, found).refused(), "CALIB_MISMATCH", KNEE, words)


def test_a_reversed_servo_that_was_calibrated_so_is_driven_as_it_was_calibrated(plant: Any) -> None:
    """Adopted, not assumed: its encoder counts against the file, and its reverse bit turns that."""
    sign = load_robot("h24").joints[load_robot("h24").names.index(KNEE)].sign
    truth = JointTruth(drive_mode=1, homing_offset=300, sign=-sign, zero_ticks=-2000)
    rig = plant(truth, truth)
    rig.arm()
    row = rig.names.index(KNEE)
    rig.submit(rig.path(KNEE, [0.5], [1.0]))
    rig.seconds(1.6)
    assert rig.truth[row] == pytest.approx(0.5, abs=0.02)


# ------------------------------------------------------------------- 10: a reboot in mid-run


def test_a_servo_that_restarts_under_torque_is_unverified_and_gets_no_goal(plant: Any) -> None:
    rig = plant(PLAIN, PLAIN)
    rig.arm()
    row, servos = rig.names.index(KNEE), rig.virtual["main"].servos
    rig.submit(rig.path(KNEE, [0.4], [2.0]))
    rig.seconds(0.5)
    rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
    verified, stood = [], float(rig.truth[row])
    for _ in range(200):
        rig.ticks(1)
        verified.append(bool(rig.loop.identity.verified.joints[row]))
    assert not all(verified) and verified[-1], "until it was asked anew"
    assert names_it(rig.said(), "SERVO_REBOOTED", KNEE, "restarted by itself")
    assert rig.loop.state is State.FAULT
    assert servos["torque_enable"][row] == 0
    assert rig.truth[row] == pytest.approx(stood, abs=0.003), "it never moves again by itself"
    rig.lease()
    assert rig.call(link.Disarm, ticks=800).error is None
    assert (rig.register("torque_enable") == 0).all()
    assert rig.call(link.Reset).error is None
    rig.lease()
    assert rig.call(link.Arm).error is None, "an operator may"


# ------------------------------------------------------------------- 11: another firmware


def test_another_firmware_is_warned_of_and_everything_read_anew(plant: Any) -> None:
    rig = plant(PLAIN, JointTruth(firmware=48))
    rig.connect()
    words = "firmware is 48, was 47 when calibrated: prove it again"
    assert names_it(rig.said(), "CALIB_MISMATCH", KNEE, words)
    rig.arm()


# ------------------------------------------------------------------- 13: torque that nobody asked for


@pytest.mark.parametrize(("mode", "bit"), [(8, "bit 3"), (4, "bit 2")])
def test_a_bit_of_the_drive_mode_that_nobody_may_rely_on_is_refused_by_name(
    plant: Any, mode: int, bit: str
) -> None:
    """3: a goal switches torque on. 2: profiles are times, and a goal is where it should be much later."""
    said = plant(PLAIN, JointTruth(drive_mode=mode)).refused()
    assert names_it(said, "DEVICE_MISMATCH", KNEE, f"drive_mode (10) is {mode}", bit)


def test_torque_at_boot_is_refused_by_its_bit_and_left_as_it_was_found(plant: Any) -> None:
    rig = plant(PLAIN, JointTruth(startup_configuration=1))
    rig.ticks(150)
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is not None
    said = rig.said(reply.parameters.get("findings", ()))
    assert names_it(said, "DEVICE_MISMATCH", KNEE, "startup_configuration (60) is 1", "bit 0")
    assert rig.energised == {KNEE}, "by itself, at its boot"
    assert rig.moved <= 1.0


# ------------------------------------------------------------------- 14: what a change of mode resets


def test_what_a_change_of_mode_has_reset_is_written_and_read_back_before_torque(plant: Any) -> None:
    rig = plant(PLAIN, PLAIN)
    rig.arm()
    row, servos = rig.names.index("r_knee"), rig.virtual["main"].servos
    assert servos["position_p_gain"][row] == 1600
    assert rig.call(link.Disarm, ticks=800).error is None
    for mode in (4, 3):  # somebody tries something, and puts it back
        servos.registers.put("operating_mode", mode, row)
        servos.power.reset_mode(row)
    servos.changed()
    assert servos["position_p_gain"][row] == 800, "as from the factory"
    rig.seconds(0.5)
    rig.lease()
    assert rig.call(link.Arm).error is None
    assert servos["position_p_gain"][row] == 1600
