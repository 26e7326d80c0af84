"""`calibrate sweep`, `zero` and `limits` with a daemon of numbers: what they ask, keep and write."""

import argparse
import itertools
import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from tests.support import transmission_robot_file as linked
from tests.support.examples import fast_cases
from tests.support.fake_calibration_daemon import FakeDaemon, held, options_of, recorded, stand_in
from twind.client import CallError, Disconnected
from twind.command_line.keep_torque_off import limp
from twind.command_line.verb import DONE, REFUSED, Rejected
from twind.config.calibration_file import Calibration, load_calibration, save_calibration
from twind.config.counts import tick_range, ticks_of
from twind.config.robot_file import load_robot
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating import (
    history_command,
    limits_command,
    sweep_command,
    zero_command,
)
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_context import CalibrationContext
from twind_calibration.calibrating.encoder_unwrap import EncoderSample
from twind_calibration.calibrating.joint_capture import JointCapture, RawExchange
from twind_calibration.calibrating.sweep_command import SweepSession
from twind_calibration.calibrating.zero_command import RecordedTravel, place_slot, travels_of
from twind_calibration.calibrating.zero_placement import by_ends, travel_of
from twind_drivers.clock import FakeClock

ROBOT = load_robot("h24")
FITTING = calibration(make_spec(ROBOT))
SLOTS = {slot.name: slot for slot in slots(ROBOT)}
KNEE = SLOTS["l_knee"]
DEVICE = FITTING.by_name["l_knee"].device
AT = "2026-11-21T09:14:03Z"
Captured = pytest.CaptureFixture[str]


def fence_of(name: str, known: Calibration = FITTING) -> tuple[int, int]:
    slot = SLOTS[name]
    return tick_range(slot.joint, known.by_name[name].zero_ticks, slot.lower, slot.upper)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return save_calibration(FITTING, tmp_path, "h24")


@pytest.fixture
def daemon(file: Path, monkeypatch: pytest.MonkeyPatch) -> FakeDaemon:
    made = FakeDaemon(ROBOT, file, FITTING)
    stand_in(monkeypatch, made, sweep_command, zero_command, limits_command)
    return made


# --------------------------------------------------------------------------------- limp


@pytest.mark.parametrize("mode", ["mirror", "live"])
def test_joints_moved_by_hand_stay_limp_in_mirror_and_in_live(daemon: FakeDaemon, mode: str) -> None:
    daemon.mode = mode
    clock = FakeClock(0.0)
    with limp(daemon, clock, take=False) as keep:  # type: ignore[arg-type]
        assert daemon.state == "calibrating"
        clock.time += 0.5
        daemon.now += 0.9
        keep()
        daemon.now += 0.9
        clock.time += 0.5
        keep()
        daemon.now += 5.0
        clock.time += 5.0
        with pytest.raises(CallError):  # the lease is gone: nobody says that they are limp
            keep()
    assert daemon.state == "connected"


# --------------------------------------------------------------------------------- sweep


class Hands:
    """A session of one joint or more, and its readings; the draft holds an earlier travel of each."""

    def __init__(self, folder: Path, *names: str, again: bool = False) -> None:
        self.place = CalibrationContext(ROBOT, folder / "h24.yaml", named=True)
        old = drafts.DraftTravel(DEVICE, (100, 1700), AT)
        made = drafts.CalibrationDraft(dict.fromkeys((*names, "head_yaw"), old))
        self.draft(lambda _: made)
        options = argparse.Namespace(
            json=False, wide=False, timeout=None, calibration=None, socket=None, joints=names, again=again
        )
        self.session = SweepSession(options, self.place, slots(ROBOT), list(names), FakeClock(0.0))
        self.session.records = dict.fromkeys(names, DEVICE)
        self.session.draft = made
        self.time = 0.0
        self.at = 1500
        self.session.begin()

    def draft(
        self, act: Callable[[drafts.CalibrationDraft], drafts.CalibrationDraft]
    ) -> drafts.CalibrationDraft:
        return drafts.change(self.place.path, ROBOT, act)

    @property
    def kept(self) -> dict[str, tuple[int, int]]:
        known = drafts.load(self.place.path, ROBOT).swept
        return {name: one.sweep_ticks for name, one in known.items()}

    def to(self, ticks: int) -> "Hands":
        """Slowly there, and a rest."""
        step = 20 if ticks > self.at else -20
        for place in [*range(self.at, ticks, step), *[ticks] * 50]:
            self.time += 0.02
            self.session.take(RawExchange(self.time, {"l_knee": EncoderSample(self.time, place)}))
        self.at = ticks
        return self


def test_an_earlier_travel_is_none_of_this_sweep(tmp_path: Path, capsys: Captured) -> None:
    hands = Hands(tmp_path, "l_knee", "l_elbow")
    hands.to(2000)
    hands.session.save(at_once=True)
    assert hands.session.close() == REFUSED
    said = capsys.readouterr().out
    assert "0 of 2 swept" in said and "`twindctl calibrate sweep l_knee l_elbow`" in said
    assert hands.kept == {"head_yaw": (100, 1700)}, "who was not asked for stays"
    hands.to(2000).to(1000).to(2550)
    hands.session.cut()
    assert "1 of 2 are kept" in (said := capsys.readouterr().out)
    assert "not done: l_elbow: it was not moved" in said
    assert "`twindctl calibrate sweep l_elbow` continues with the others" in said
    assert set(hands.kept) == {"head_yaw", "l_knee"} and hands.kept["l_knee"][0] == 1000


def terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)


def disconnect() -> None:
    raise Disconnected("the daemon ended")


@pytest.mark.parametrize("words", [(), ("--json",)])
@pytest.mark.parametrize(("end", "error"), [(terminate, KeyboardInterrupt), (disconnect, Disconnected)])
def test_an_interrupted_sweep_reports_each_open_joint_with_reason_and_next_step(
    daemon: FakeDaemon,
    end: Callable[[], None],
    error: type[BaseException],
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: Captured,
) -> None:
    whole = daemon.readings

    def readings() -> Any:
        yield from itertools.islice(whole(), 3)
        end()

    monkeypatch.setattr(daemon, "readings", readings)
    handler = signal.getsignal(signal.SIGTERM)
    with pytest.raises(error):
        sweep_command.sweep(options_of("sweep", "l_knee", "l_elbow", *words))
    assert signal.getsignal(signal.SIGTERM) == handler
    reason = "it was not moved; move it slowly to both ends and rest half a second at each"
    said = capsys.readouterr().out
    if words:
        last = json.loads(said.splitlines()[-1])
        assert last["left"] == {"l_knee": reason, "l_elbow": reason}
        assert (last["done"], last["interrupted"]) == ([], True)
        assert last["next"] == "twindctl calibrate sweep l_elbow l_knee"
    else:
        assert (
            f"not done: l_elbow: {reason}\nnot done: l_knee: {reason}\ninterrupted: 0 of 2 are kept" in said
        )


def test_a_travel_that_grows_too_wide_leaves_the_draft(tmp_path: Path, capsys: Captured) -> None:
    hands = Hands(tmp_path, "l_knee")
    hands.to(2000).to(1000).to(2550)
    assert "l_knee" in hands.kept
    hands.to(3300).to(900)
    assert "l_knee" not in hands.kept
    hands.session.save(at_once=True)
    assert hands.session.close() == REFUSED
    assert "not done: l_knee" in capsys.readouterr().out


# --------------------------------------------------------------------------------- zero


def standing(daemon: FakeDaemon, angle: float = 0.0) -> None:
    for name, slot in SLOTS.items():
        daemon.ticks[name] = ticks_of(slot.joint, FITTING.by_name[name].zero_ticks, angle)


@pytest.mark.parametrize("mode", ["mirror", "live"])
def test_calibration_never_arms_however_long_the_readings_take(
    daemon: FakeDaemon, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon.mode = mode
    standing(daemon)
    clock = FakeClock(0.0)
    monkeypatch.setattr(zero_command, "MonotonicClock", lambda: clock)

    real = daemon.readings

    def readings() -> Any:
        for each in real():
            clock.time = daemon.now
            yield each

    monkeypatch.setattr(daemon, "readings", readings)
    assert zero_command.zero(options_of("zero", "l_knee", "--samples", "400", "--yes")) == DONE
    assert daemon.now > 104.0 and set(daemon.states) == {"calibrating"}
    assert daemon.state == "connected"


def test_a_draft_is_newer_than_the_file() -> None:
    draft = drafts.CalibrationDraft({"l_knee": drafts.DraftTravel(DEVICE, (7, 1600), AT)})
    known = travels_of(draft, FITTING)
    assert known["l_knee"].sweep == (7, 1600)
    assert known["l_elbow"].sweep == FITTING.by_name["l_elbow"].sweep_ticks


def test_a_joint_that_stands_outside_its_travel_has_no_zero() -> None:
    """In a pose a little beyond its limits, so that the limits alone would fit."""
    sweep = (1000, 2600)
    far = 2600 + KNEE.ticks(0.2)
    placed = place_slot(
        KNEE, RecordedTravel(DEVICE, sweep), DEVICE, JointCapture(50, far, 0.5), KNEE.upper + 0.14
    )
    assert placed.entry is None and [wrong.split(",")[0] for wrong in placed.wrong] == [f"it stands at {far}"]
    near = place_slot(KNEE, RecordedTravel(DEVICE, sweep), DEVICE, JointCapture(50, 2600, 0.5), KNEE.upper)
    assert near.entry is not None


@pytest.mark.parametrize("how", [(), ("--from-sweep",)])
def test_a_joint_with_a_zero_gets_another_only_on_request(
    daemon: FakeDaemon, how: tuple[str, ...], capsys: Captured
) -> None:
    standing(daemon)
    before = daemon.file.read_text()
    with pytest.raises(Rejected, match="name those that are to get another, or --all for all"):
        zero_command.zero(options_of("zero", *how, "--yes"))
    assert daemon.file.read_text() == before
    assert zero_command.zero(options_of("zero", *how, "--yes", "l_knee")) == DONE
    changed = [name for name in ROBOT.names if method(daemon, name) != "import"]
    assert changed == ["l_knee"]
    assert zero_command.zero(options_of("zero", *how, "--yes", "--all")) == DONE
    assert {method(daemon, name) for name in ROBOT.names} == {"sweep" if how else "jig"}


def method(daemon: FakeDaemon, name: str) -> str:
    return load_calibration(daemon.file, ROBOT).by_name[name].method


def test_a_joint_with_one_known_stop_has_an_unknown_zero_uncertainty(capsys: Captured) -> None:
    stops = replace(KNEE.joint.stops, upper=None)
    slot = replace(KNEE, joint=replace(KNEE.joint, stops=stops))
    sweep = FITTING.by_name["l_knee"].sweep_ticks
    one = place_slot(slot, RecordedTravel(DEVICE, sweep), DEVICE, None, None)
    assert one.entry is not None and one.entry.captures == 1
    assert one.spread is None and one.to_json()["sigma_ticks"] is None
    assert "spread unknown" in one.line(6)
    two = place_slot(KNEE, RecordedTravel(DEVICE, sweep), DEVICE, None, None)
    assert two.spread == by_ends(KNEE, sweep, *KNEE.joint.stops.endstops_by_side.values()).sigma
    said = zero_command.describe_coarse_zeros([one, two])
    assert "+-" in said and "accuracy is unknown where only one end is known: l_knee" in said
    assert "+-" not in zero_command.describe_coarse_zeros([one])


def test_an_impossible_actuator_pose_is_reported_by_its_joints(tmp_path: Path) -> None:
    robot = linked.linked(tmp_path)
    place = CalibrationContext(robot, tmp_path / "linked.yaml", named=True)
    options = options_of("zero", "--at", "waist_roll=0.6", "--at", "waist_yaw=2.0")
    with pytest.raises(Rejected, match="`--at waist_roll=RAD --at waist_yaw=RAD` gives waist_roll and"):
        zero_command.parse_angles(options, place, slots(robot))


# --------------------------------------------------------------------------------- tags


def test_a_tag_is_compared_and_kept_whatever_is_calibrated(
    daemon: FakeDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Register 24 of a stamped servo; of others it is not looked at."""
    knee = FITTING.by_name["l_knee"]
    stamped = replace(knee, device=replace(knee.device, tag=613))
    known = replace(FITTING, joints=tuple(stamped if one == knee else one for one in FITTING.joints))
    save_calibration(known, daemon.file.parent, "h24")
    standing(daemon)
    with pytest.raises(Rejected, match=r"moving_threshold is 10, was 613"):
        limits_command.limits(options_of("limits", "l_knee", "--yes"))
    daemon.servos[knee.id]["moving_threshold"] = 613
    assert limits_command.limits(options_of("limits", "l_knee", "head_yaw", "--yes")) == DONE
    assert zero_command.zero(options_of("zero", "l_knee", "head_yaw", "--yes")) == DONE
    after = load_calibration(daemon.file, ROBOT).by_name
    assert after["l_knee"].device.tag == 613 and after["head_yaw"].device.tag is None
    assert after["l_knee"].method == "jig"


# --------------------------------------------------------------------------------- limits

PAIR = ("head_pitch", "l_knee")


@pytest.mark.parametrize("first", [(0, 4095), (0, 100), (3500, 4000)])
def test_limits_are_written_in_an_order_that_a_servo_takes(
    daemon: FakeDaemon, first: tuple[int, int]
) -> None:
    device = replace(DEVICE, min_ticks=first[0], max_ticks=first[1])
    knee = replace(FITTING.by_name["l_knee"], device=device)
    others = [one for one in FITTING.joints if one.name != "l_knee"]
    save_calibration(replace(FITTING, joints=(*others, knee)), daemon.file.parent, "h24")
    daemon.servos[knee.id] |= {"min_position_limit": first[0], "max_position_limit": first[1]}
    assert limits_command.limits(options_of("limits", "l_knee", "--yes")) == DONE
    assert held(daemon, "l_knee") == recorded(daemon, "l_knee") == fence_of("l_knee")
    assert "WriteRegister" not in daemon.asked[daemon.asked.index("ReleaseLease") :]


def broken_off(daemon: FakeDaemon, writes: int, error: BaseException) -> None:
    """After so many writes, each of them obeyed."""
    left = [writes]

    def break_off(method: str, how: Any) -> None:
        if method == "WriteRegister":
            left[0] -= 1
            if left[0] == 0:
                raise error

    daemon.break_off = break_off


INTERRUPTIONS = {
    "ctrl-c": KeyboardInterrupt(),
    "disconnected": Disconnected("gone"),
    "pipe": BrokenPipeError(),
    "refused": CallError("io.twind.Control.DeviceFailed", {"message": "no answer"}),
}


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize(
    ("writes", "interruption"),
    fast_cases(product((1, 2, 3, 4), INTERRUPTIONS), list(zip((1, 2, 3, 4), INTERRUPTIONS, strict=True))),
)
def test_an_interrupted_limits_command_is_completed_by_running_it_again(
    daemon: FakeDaemon, capsys: Captured, interruption: str, writes: int, silent: bool
) -> None:
    """`silent`: nobody tells what the servo in hand holds."""
    error = INTERRUPTIONS[interruption]
    broken_off(daemon, writes, error)
    scan = daemon.scan
    if silent:
        known = list(scan())
        scans = iter([known])
        daemon.scan = lambda: iter(next(scans, []))  # type: ignore[method-assign]
    with pytest.raises((Rejected, type(error))) as raised:
        limits_command.limits(options_of("limits", *PAIR, "--yes"))
    said = capsys.readouterr().err + str(raised.value)
    assert "`twindctl calibrate limits head_pitch l_knee` brings servos and file to agreement" in said
    in_hand = PAIR[(writes - 1) // 2]
    for name in PAIR:
        if not silent or name != in_hand:
            assert held(daemon, name) == recorded(daemon, name), name
    # type: ignore[method-assign]
    daemon.break_off = lambda method, how: None
    daemon.scan = scan
    assert limits_command.limits(options_of("limits", *PAIR, "--yes")) == DONE
    for name in PAIR:
        assert held(daemon, name) == recorded(daemon, name) == fence_of(name)
    assert limits_command.limits(options_of("limits", *PAIR, "--yes")) == DONE
    assert "every servo has the limits of its joint" in capsys.readouterr().out


def test_limits_already_on_the_servo_are_recorded_without_a_write(daemon: FakeDaemon) -> None:
    """As after a rollback past it."""
    assert limits_command.limits(options_of("limits", "l_knee", "--yes")) == DONE
    save_calibration(FITTING, daemon.file.parent, "h24")
    assert recorded(daemon, "l_knee") != held(daemon, "l_knee")
    daemon.asked.clear()
    assert limits_command.limits(options_of("limits", "l_knee", "--yes")) == DONE
    assert "WriteRegister" not in daemon.asked
    assert recorded(daemon, "l_knee") == held(daemon, "l_knee") == fence_of("l_knee")


def test_a_servo_that_is_another_is_not_fenced(daemon: FakeDaemon) -> None:
    daemon.servos[daemon.ids["l_knee"]]["homing_offset"] = 20
    before = held(daemon, "l_knee")
    with pytest.raises(Rejected, match=r"l_knee is not as it was calibrated: homing_offset is 20"):
        limits_command.limits(options_of("limits", *PAIR, "--yes"))
    del daemon.servos[daemon.ids["l_knee"]]
    with pytest.raises(Rejected, match="no device answers there"):
        limits_command.limits(options_of("limits", *PAIR, "--yes"))
    assert "WriteRegister" not in daemon.asked and before != fence_of("l_knee")


def test_limits_that_leave_the_counts_are_refused_before_anything_is_written(daemon: FakeDaemon) -> None:
    knee = FITTING.by_name["l_knee"]
    device = replace(knee.device, homing_offset_ticks=-512)
    zero_at = -300
    low = fence_of("l_knee")[0] - knee.zero_ticks
    sweep = travel_of(KNEE, device, (zero_at + low - 40, zero_at + low + 1600))
    moved = replace(knee, device=device, zero_ticks=zero_at, sweep_ticks=sweep)
    made = limits_command.fences_of([KNEE], replace(FITTING, joints=(knee,)), {"l_knee": knee.device})
    assert len(made) == 1
    with pytest.raises(Rejected, match=r"leave the counts 0\.\.4095"):
        limits_command.fences_of([KNEE], replace(FITTING, joints=(moved,)), {"l_knee": device})


def test_a_rollback_past_recorded_limits_names_the_command_that_restores_agreement(
    daemon: FakeDaemon, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    assert limits_command.limits(options_of("limits", *PAIR, "--yes")) == DONE

    def rollback() -> str:
        options = argparse.Namespace(
            json=False, yes=True, which="1", socket=None, calibration=None, config=None, robot=None, port=None
        )
        place = CalibrationContext(ROBOT, daemon.file, named=True)
        monkeypatch.setattr(history_command, "_place", lambda options: place)
        assert history_command.rollback(options) == DONE
        return capsys.readouterr().out

    assert "`twindctl calibrate limits head_pitch l_knee`" in rollback()
    assert "calibrate limits" not in rollback(), "the same file again"
