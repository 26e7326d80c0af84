"""Conclusions of sweep and zero from readings alone: verdicts with their causes, drafts, entries."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.command_line.verb import Rejected
from twind.config.atomic_save import draft_of
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import dump_calibration, read_calibration
from twind.config.counts import tick_range, ticks_of
from twind.config.homing_config import JointEndstops
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext
from twind_calibration.calibrating.calibration_draft import CalibrationDraft, DraftTravel
from twind_calibration.calibrating.encoder_unwrap import EncoderSample, framed
from twind_calibration.calibrating.entry_writer import merged
from twind_calibration.calibrating.sweep_display import bar
from twind_calibration.calibrating.sweep_tracker import SweepStage, SweepTracker, describe_open_limits
from twind_calibration.calibrating.travel_verdict import judge
from twind_calibration.calibrating.zero_placement import (
    TOLERANCE,
    ZeroOffset,
    by_ends,
    by_pose,
    expected_servo_limits,
    make_entry,
    misfits,
    spread,
)

ROBOT = load_robot("h24")
SLOTS = slots(ROBOT)
NAMED = {slot.name: slot for slot in SLOTS}
KNEE = NAMED["l_knee"]  # -0.1..2.2 rad, sign 1
TURN = 4096
DEVICE = DeviceRecord(1020, 47, None, 0, 0, 3, 0, 4095)
TWICE = replace(KNEE, joint=replace(KNEE.joint, sign=-1))


def span_of(slot: CalibrationActuator, share: float) -> int:
    return slot.ticks(share * slot.range)


def test_joints_with_open_limits_are_named_with_what_ends_their_sweep() -> None:
    text = describe_open_limits(["l_knee", "r_knee"], "ENTER")
    assert text.startswith("limits_rad of l_knee, r_knee: open") and text.endswith("ENTER takes them")


# ------------------------------------------------------------------------------------------- travel


@given(st.sampled_from(SLOTS), st.floats(0.61, 1.29))
def test_a_travel_near_the_described_one_is_good(slot: CalibrationActuator, share: float) -> None:
    if span_of(slot, share) < TURN:
        assert judge(slot, span_of(slot, share), SLOTS).is_acceptable


@given(st.sampled_from(SLOTS), st.one_of(st.floats(0.0, 0.59), st.floats(1.31, 8.0)))
def test_any_other_is_refused_with_a_cause(slot: CalibrationActuator, share: float) -> None:
    judged = judge(slot, span_of(slot, share), SLOTS)
    assert not judged.is_acceptable and judged.causes
    assert f"{100 * judged.share:.0f} % of" in judged.wrong or "turns of its actuator" in judged.wrong


def test_the_cause_is_named_ratio_joint_or_an_end_that_was_left_out() -> None:
    def causes(name: str, share: float) -> str:
        return "; ".join(judge(NAMED[name], span_of(NAMED[name], share), SLOTS).causes)

    assert "its ratio: 2 instead of 1 would fit" in causes("waist_pitch", 2.0)
    assert "its ratio: 0.5 instead of 1 would fit" in causes("l_hip_yaw", 0.5)
    assert "it was not moved to both its ends" in causes("l_hip_yaw", 0.3)
    assert "the wrong joint: it goes as far as l_shoulder_roll" in causes("waist_pitch", 2.0)
    assert "limits_rad of waist_pitch are not those of this robot" in causes("waist_pitch", 1.5)


def test_a_whole_turn_is_refused_whatever_it_is_of() -> None:
    wide = replace(KNEE, joint=replace(KNEE.joint, stops=JointEndstops(-3.1, 3.1)))
    assert judge(wide, TURN - 1).is_acceptable
    judged = judge(wide, TURN)
    assert "which its goals reach after any power-up" in judged.wrong and not judged.wide


def test_a_nan_range_is_refused() -> None:
    unknown = replace(KNEE.joint, upper=float("nan"), stops=JointEndstops())
    assert not judge(replace(KNEE, joint=unknown), 1000).is_acceptable


# ------------------------------------------------------------------------------------------- who moves


class Hands:
    """Moves joints of a limp robot, one reading every 10 ms."""

    def __init__(self, asked: list[str], *, wide: bool = False, start: int = 3000) -> None:
        self.travels = SweepTracker(SLOTS, asked, wide=wide)
        self.places = dict.fromkeys(NAMED, start)
        self.time = 0.0
        self.news: list[str] = []
        self.pass_(1)

    def pass_(self, readings: int) -> None:
        for _ in range(readings):
            self.time += 0.01
            heard = {name: EncoderSample(self.time, place % TURN) for name, place in self.places.items()}
            self.news += [f"{each.what} {each.text}" for each in self.travels.take(heard)]

    def go(self, name: str, ticks: int) -> None:
        for step in [30 * (1 if ticks > 0 else -1)] * (abs(ticks) // 30):
            self.places[name] += step
            self.pass_(1)

    def sweep(self, name: str, ticks: int) -> None:
        self.go(name, ticks // 2)
        self.pass_(50)
        self.go(name, -ticks)
        self.pass_(50)


def test_a_joint_is_done_when_it_rested_at_both_ends_and_the_sweep_when_all_are() -> None:
    hands = Hands(["l_knee", "head_pitch"])
    hands.sweep("l_knee", 1500)
    assert hands.travels.progress("l_knee").stage is SweepStage.DONE and not hands.travels.is_finished
    assert hands.travels.progress("head_pitch").stage is SweepStage.STILL
    hands.sweep("head_pitch", 1120)
    assert hands.travels.is_finished and [each.split()[0] for each in hands.news] == ["done", "done"]
    low, high = hands.travels.travel("l_knee") or (0, 0)
    assert 1440 <= high - low <= 1500
    hands.go("l_knee", 1600)  # who moves it further afterwards makes its travel longer
    hands.pass_(50)
    low, high = hands.travels.travel("l_knee") or (0, 0)
    assert high - low >= 1560


def test_half_a_travel_is_not_done_and_enter_takes_one_that_fits_without_rest() -> None:
    hands = Hands(["l_knee"])
    hands.sweep("l_knee", 600)
    assert hands.travels.progress("l_knee").stage is SweepStage.MOVING
    assert hands.travels.travel("l_knee", at_once=True) is None
    hands.go("l_knee", 1400)
    assert hands.travels.travel("l_knee") is None
    why = hands.travels.open_reason("l_knee")
    assert why.startswith("it did not rest at its end of highest counts; move it slowly")
    assert hands.travels.travel("l_knee", at_once=True) is not None


def test_a_sweep_that_is_not_complete_names_each_end_at_which_the_joint_did_not_rest() -> None:
    hands = Hands(["l_knee"])
    hands.go("l_knee", 1200)
    why = "it did not rest at its end of lowest counts and its end of highest counts; move it slowly"
    assert hands.travels.open_reason("l_knee").startswith(why)
    short = Hands(["l_knee"])
    short.sweep("l_knee", 1140)
    assert short.travels.open_reason("l_knee").startswith("it went 1.75 rad, too little of the way")


def test_a_resting_position_is_no_end_and_three_quarters_of_a_travel_are_incomplete() -> None:
    hands = Hands(["r_hip_pitch"])
    hands.pass_(100)
    hands.go("r_hip_pitch", 1160)  # from 0 to one stop: 74 % of what it should go
    hands.pass_(100)
    assert hands.travels.progress("r_hip_pitch").ends == (False, True)
    hands.go("r_hip_pitch", -1160)
    hands.pass_(100)
    assert hands.travels.progress("r_hip_pitch").stage is SweepStage.MOVING and not hands.travels.is_finished
    hands.go("r_hip_pitch", -420)
    hands.pass_(100)
    low, high = hands.travels.travel("r_hip_pitch") or (0, 0)
    assert high - low == pytest.approx(1580, abs=60) and hands.travels.is_finished


def test_a_travel_that_is_too_wide_is_wrong_unless_it_is_taken_as_it_is() -> None:
    for wide, stage in ((False, SweepStage.WRONG), (True, SweepStage.DONE)):
        hands = Hands(["waist_pitch"], wide=wide)
        hands.sweep("waist_pitch", 1200)
        assert hands.travels.progress("waist_pitch").stage is stage and hands.travels.is_finished
        assert ("`--wide` takes it" in hands.news[-1]) is not wide
        assert (hands.travels.travel("waist_pitch", at_once=True) is not None) is wide


def test_a_travel_that_was_done_and_grows_too_wide_is_one_no_more() -> None:
    hands = Hands(["l_knee"])
    hands.sweep("l_knee", 1500)
    assert hands.travels.travel("l_knee") is not None
    hands.go("l_knee", 2400)
    hands.pass_(50)
    assert hands.travels.progress("l_knee").stage is SweepStage.WRONG
    assert "rest half a second" not in hands.travels.open_reason("l_knee"), "its ratio is wrong, not the hand"
    assert hands.travels.travel("l_knee") is None and hands.travels.travel("l_knee", at_once=True) is None


def test_a_joint_that_moves_in_place_of_the_requested_one_is_reported_once() -> None:
    hands = Hands(["l_knee"])
    hands.go("r_knee", 900)
    [told] = hands.news
    assert told == (
        "strayed r_knee moved while l_knee, asked for, did not: are their ids swapped, or was the other "
        "joint moved?"
    )
    other = Hands(["l_knee"])
    other.go("l_knee", 300)
    other.go("r_knee", 900)  # it hangs on the same robot: no word
    assert not other.news


def test_a_lost_reading_begins_a_joint_anew_and_takes_nothing_from_one_that_is_done() -> None:
    hands = Hands(["l_knee", "head_yaw"])
    hands.sweep("l_knee", 1500)
    hands.go("head_yaw", 900)
    for name in ("l_knee", "head_yaw"):
        hands.places[name] += 1500
    hands.pass_(1)
    assert [each.split()[0] for each in hands.news] == ["done", "lost"]
    assert "move head_yaw again, from end to end" in hands.news[-1]
    assert hands.travels.progress("l_knee").stage is SweepStage.DONE
    assert hands.travels.progress("head_yaw").stage is SweepStage.STILL
    assert hands.travels.open_reason("head_yaw").endswith("; move head_yaw again, from end to end")
    hands.go("head_yaw", 900)
    assert "it was not moved to both its ends" in hands.travels.open_reason("head_yaw")
    assert hands.travels.travel("l_knee") is not None


# ------------------------------------------------------------------------------------------- the zero


def true_sweep(slot: CalibrationActuator, zero: int, extra: float = 0.05) -> tuple[int, int]:
    low, high = tick_range(slot.joint, zero, slot.lower - extra, slot.upper + extra)
    return framed(low, high, slot.start, TURN)


@given(
    st.sampled_from(SLOTS), st.integers(-6000, 6000), st.floats(0.0, 1.0), st.integers(-3, 3), st.booleans()
)
def test_a_pose_finds_the_zero_on_whatever_turn_it_reads(
    slot: CalibrationActuator, zero: int, share: float, turns: int, wrapped: bool
) -> None:
    sweep = true_sweep(slot, zero)
    angle = slot.lower + share * (slot.upper - slot.lower)
    reading = ticks_of(slot.joint, zero, angle) + turns * TURN
    found = by_pose(slot, sweep, float(reading % TURN if wrapped else reading), 0.5, 50, angle)
    assert abs((found.ticks - zero + TURN // 2) % TURN - TURN // 2) <= 1
    entry = make_entry(slot, DEVICE, sweep, found)
    first, last = tick_range(slot.joint, entry.zero_ticks, slot.lower, slot.upper)
    assert entry.sweep_ticks[0] <= first < last <= entry.sweep_ticks[1]  # in the frame of the travel


@given(st.sampled_from(SLOTS), st.integers(-6000, 6000))
def test_the_ends_of_the_travel_give_the_zero_and_its_uncertainty(
    slot: CalibrationActuator, zero: int
) -> None:
    sweep = true_sweep(slot, zero, 0.0)
    found = by_ends(slot, sweep, slot.lower, slot.upper)
    assert abs((found.ticks - zero + TURN // 2) % TURN - TURN // 2) <= 2 and found.sigma <= 1.0
    uneven = by_ends(slot, sweep, slot.lower - 0.1, slot.upper)
    assert uneven.sigma == pytest.approx(slot.ticks(0.05), abs=2)
    one = by_ends(slot, sweep, None, slot.upper)
    assert abs((one.ticks - zero + TURN // 2) % TURN - TURN // 2) <= 2
    assert spread(make_entry(slot, DEVICE, sweep, one)) is None, "nobody knows"
    assert spread(make_entry(slot, DEVICE, sweep, found)) == found.sigma
    with pytest.raises(ValueError):
        by_ends(slot, sweep, None, None)


def test_a_zero_whose_limits_leave_the_travel_is_refused_and_a_mirrored_one_is_called_so() -> None:
    sweep = true_sweep(KNEE, 2000)
    assert misfits(KNEE, DEVICE, sweep, 2000, 2000) == []
    spare = KNEE.ticks(TOLERANCE + 0.05)
    assert misfits(KNEE, DEVICE, sweep, 2000 + spare - 4) == []
    [moved] = misfits(KNEE, DEVICE, sweep, 2000 + spare + 4)
    assert "rad beyond its travel" in moved and "another pose" in moved
    [mirrored] = misfits(TWICE, DEVICE, sweep, 2000)
    assert "with sign 1 they would fit: is its sign wrong" in mirrored
    [outside] = misfits(KNEE, DEVICE, sweep, 2000, sweep[1] + KNEE.ticks(TOLERANCE) + 1)
    assert "outside its travel" in outside


def test_limits_across_the_seam_are_refused_in_position_mode_alone() -> None:
    sweep = true_sweep(KNEE, 4000)
    zero = by_pose(KNEE, sweep, 4000.0, 0.0, 50, 0.0).ticks
    [seam] = misfits(KNEE, DEVICE, sweep, zero)
    assert "cross its encoder's seam, which mode position cannot" in seam
    extended = replace(KNEE, joint=replace(KNEE.joint, mode="extended_position"))
    assert misfits(extended, DEVICE, sweep, zero) == []
    assert expected_servo_limits(extended, zero) is None


def test_the_fence_is_the_limits_rounded_inwards() -> None:
    assert expected_servo_limits(KNEE, 2051) == tick_range(KNEE.joint, 2051, KNEE.lower, KNEE.upper)


@pytest.mark.parametrize(("offset", "zero"), [(-512, -300), (512, 2900)])
def test_limits_beyond_the_counts_of_position_mode_are_refused_and_never_cut(offset: int, zero: int) -> None:
    """A homing offset moves the counts, and goals and limits stay within 0..4095."""
    device = replace(DEVICE, homing_offset_ticks=offset)
    first, last = expected_servo_limits(KNEE, zero) or (0, 0)
    assert first < 0 or last > 4095
    [wrong] = misfits(KNEE, device, (first - 40, last + 40), zero)
    assert (
        f"{first}..{last} leave the counts 0..4095" in wrong
        and f"homing_offset is {offset}, write 0" in wrong
    )
    inside = replace(DEVICE, homing_offset_ticks=-100)
    first, last = expected_servo_limits(KNEE, 2048) or (0, 0)
    assert misfits(KNEE, inside, (first - 40, last + 40), 2048) == []


# ------------------------------------------------------------------------------------------- the files


@given(
    st.dictionaries(
        st.sampled_from([slot.name for slot in SLOTS]),
        st.tuples(st.integers(-9000, 9000), st.integers(1, 4095)),
    )
)
def test_a_draft_reads_back_as_it_was_written(travels: dict[str, tuple[int, int]]) -> None:
    draft = CalibrationDraft(
        {
            name: DraftTravel(DEVICE, (first, first + span), "2026-11-21T09:14:03Z")
            for name, (first, span) in travels.items()
        }
    )
    assert drafts.read(drafts.dump(draft, ROBOT), "draft", ROBOT) == draft


def test_a_draft_is_bound_to_the_description_and_leaves_with_its_last_joint(tmp_path: Path) -> None:
    path = tmp_path / "h24.yaml"
    swept = DraftTravel(DEVICE, (1, 2000), "2026-11-21T09:14:03Z")
    assert drafts.load(path, ROBOT) == CalibrationDraft()
    drafts.change(path, ROBOT, lambda known: known.joined("l_knee", swept))
    kept = draft_of(tmp_path, "h24")
    assert kept.exists() and kept.name == ".h24.draft.yaml"
    assert drafts.load(path, ROBOT).swept == {"l_knee": swept}
    other = replace(ROBOT, joints=(replace(ROBOT.joints[0], sign=-1), *ROBOT.joints[1:]))
    with pytest.raises(Rejected, match="joints, ids, signs or ratios changed since"):
        drafts.load(path, other)
    with pytest.raises(ConfigError, match="unknown"):
        drafts.read(drafts.dump(CalibrationDraft({"l_tail": swept}), ROBOT), "draft", ROBOT)
    drafts.change(path, ROBOT, lambda known: known.without(["l_knee"]))
    assert not kept.exists()


def test_an_unwritable_folder_is_reported_before_any_joint_is_moved(tmp_path: Path) -> None:
    drafts.require_room(tmp_path / "new" / "calibration" / "h24.yaml")
    (tmp_path / "file").write_text("")
    with pytest.raises(Rejected, match="try with sudo"):
        drafts.require_room(tmp_path / "file" / "h24.yaml")


def test_new_entries_take_the_place_of_the_old_ones_in_the_robots_order() -> None:
    place = CalibrationContext(ROBOT, Path("h24.yaml"), named=False)
    knee, yaw = (
        make_entry(NAMED[name], DEVICE, true_sweep(NAMED[name], 2000), ZeroOffset(2000, 0.4, 50, "jig"))
        for name in ("l_knee", "head_yaw")
    )
    first = merged(place, None, [knee])
    both = merged(place, first, [yaw, replace(knee, zero_ticks=2001)])
    assert [each.name for each in both.joints] == ["head_yaw", "l_knee"]
    assert both.by_name["l_knee"].zero_ticks == 2001
    assert read_calibration(dump_calibration(both), "file", ROBOT).by_name == both.by_name


@given(st.floats(0.0, 5.0))
def test_a_bar_has_one_width(share: float) -> None:
    assert len(bar(share)) == 24


def test_a_bar_is_full_at_the_described_travel() -> None:
    assert bar(1.0) == "█" * 20 + "▏   " and bar(0.0).strip() == "▏" and bar(9.0) == "█" * 24
