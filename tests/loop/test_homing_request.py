"""Request of an end-stop search: its numbers in counts, and each reason against it. Nothing is written."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from math import ceil, floor, inf, nan
from typing import Any

import pytest

from tests.support.described_robot import redescribe
from tests.support.homing_rig import JOINT, OTHER, RAD, Homed, homed
from tests.support.long_waist import STOP, long_waist_in, started
from tests.support.planar_arm import WAIST
from twind import link
from twind.config.homing_config import JointEndstops
from twind.config.robot_file import load_robot
from twind.loop.procedures import homing_request
from twind.loop.procedures.homing_request import HomingRequest, place_on_bus, resolve_request, turns_between
from twind.loop.procedures.procedure_runner import ProcedureFailed
from twind.robot.finding import Finding, ReasonCode

PITCH = "r_shoulder_pitch"  # its counts grow towards its lower stop
CAP = 102  # raw: 12 % of the 2.3 A that its file allows


@pytest.fixture(scope="module")
def yaw() -> Iterator[Homed]:
    with homed() as made:
        made.ready()
        yield made


@pytest.fixture(scope="module")
def pitch() -> Iterator[Homed]:
    with homed(joint=PITCH, start={PITCH: -2.4}) as made:
        made.ready()
        yield made


def resolve(made: Any, side: str = "lower", joint: int | None = None, client: int = 7, **how: Any) -> Any:
    loop = made.loop
    command = link.FindStop(
        ticket=1, client=client, joint=made.place if joint is None else joint, side=side, **how
    )
    return resolve_request(loop, loop.commands.gate_input, loop.identity.verified, command, loop.clock.now())


def requested(made: Any, side: str = "lower", **how: Any) -> HomingRequest:
    found = resolve(made, side, **how)
    assert isinstance(found, HomingRequest), found
    return found


def refused(made: Any, side: str = "lower", **how: Any) -> list[Finding]:
    found = resolve(made, side, **how)
    assert isinstance(found, list), found
    return found


@contextmanager
def described(made: Homed, **changes: Any) -> Iterator[None]:
    """Meanwhile the robot file says something else of its joint."""
    before = made.spec
    changed = replace(before, **changes)
    joints = tuple(changed if each.name == before.name else each for each in made.robot.joints)
    redescribe(made.loop, bound=replace(made.one, file=replace(made.robot, joints=joints)))
    try:
        yield
    finally:
        redescribe(made.loop, bound=made.one)


# ------------------------------------------------------------------------------- in counts


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize(("name", "sign"), [("yaw", 1), ("pitch", -1)])
def test_a_usual_search_is_slow_weak_and_bounded_around_the_described_stop(
    request: pytest.FixtureRequest, name: str, sign: int, side: str
) -> None:
    made: Homed = request.getfixturevalue(name)
    found = requested(made, side)
    search = found.search
    stop = made.spec.stops.endstop_of_side(side)
    assert stop is not None
    number, row, bus = place_on_bus(made.loop, made.place)
    way = sign * (1 if side == "upper" else -1)
    expected = bus.zero[row] + stop / bus.scale[row]
    assert search.way == way
    assert {each.name: getattr(search, each.name) for each in fields(search) if each.name != "way"} == (
        pytest.approx(
            {
                "expected": expected,
                "margin": 0.2 * RAD,
                "speed": 0.2 * RAD,
                "cap": CAP,
                "back": 0.12 * RAD,
                "lead": 0.2 * RAD,
                "astray": 0.15 * RAD,
                "still": 0.006 * RAD,
                "times": 3,
                "turn": 0.0,
                "away": 0.0,
            }
        )
    )
    count = int(made.loop.hardware.readings.raw.ticks[made.place])
    end = expected + way * 0.2 * RAD
    away = expected - way * (0.2 + 0.12 + 0.006) * RAD
    ends = (end, away, count - way * 8)
    assert (found.lower, found.upper) == (floor(min(ends)) - 1, ceil(max(ends)) + 1)
    assert (found.joint, found.id, found.cap, found.turn) == (made.place, made.spec.id, CAP, 4096)
    assert found.jump == pytest.approx(0.05 * RAD) and found.shift == 0
    assert found.port is made.loop.hardware.ports[number]
    assert found.profile == ceil(2.0 * 0.2 / made.spec.type.velocity_lsb_rad_s)


@pytest.mark.parametrize(
    ("how", "field", "value"),
    [
        ({"current_share": 0.03}, "cap", 25),
        ({"current_share": 0.15}, "cap", 128),
        ({"speed": 0.02}, "speed", 0.02 * RAD),
        ({"speed": 0.5}, "speed", 0.5 * RAD),
        ({"times": 2}, "times", 2),
        ({"times": 10}, "times", 10),
    ],
)
def test_a_client_may_ask_for_less_or_a_little_more(
    yaw: Homed, how: dict[str, Any], field: str, value: float
) -> None:
    assert getattr(requested(yaw, **how).search, field) == pytest.approx(value)


def test_a_joint_that_may_be_no_faster_is_searched_no_faster(yaw: Homed) -> None:
    with described(yaw, velocity_limit=0.1):
        assert requested(yaw).search.speed == pytest.approx(0.1 * RAD)


def test_a_very_slow_search_has_a_profile_all_the_same(yaw: Homed) -> None:
    with described(yaw, type=replace(yaw.spec.type, velocity_lsb_rad_s=100.0)):
        assert requested(yaw).profile == 1


def test_a_joint_of_few_counts_may_flicker_by_two(yaw: Homed, monkeypatch: pytest.MonkeyPatch) -> None:
    number, row, bus = place_on_bus(yaw.loop, yaw.place)
    coarse = replace(bus, scale=bus.scale * 4.0)
    monkeypatch.setattr(homing_request, "place_on_bus", lambda *_: (number, row, coarse))
    with described(yaw, stops=JointEndstops(lower=-6.4)):
        assert requested(yaw).search.still == 2.0


@pytest.mark.parametrize(
    ("side", "limits", "back"),
    [("lower", {"lower": -1.3}, 0.32), ("upper", {"upper": 1.2}, 0.42), ("lower", {"lower": -1.58}, 0.1)],
)
def test_it_backs_off_until_the_joint_may_be_armed(
    yaw: Homed, side: str, limits: dict[str, float], back: float
) -> None:
    with described(yaw, **limits):
        assert requested(yaw, side).search.back == pytest.approx(back * RAD)


@pytest.mark.parametrize(("own", "cap"), [(1193, CAP), (500, 60), (3, 1)])
def test_the_cap_is_a_share_of_the_lesser_limit_of_file_and_servo(pitch: Homed, own: int, cap: int) -> None:
    port = pitch.loop.hardware.ports[0]
    before = port.devices
    port.devices = tuple(
        replace(each, settings={**each.settings, "current_limit": own}) if each.id == pitch.spec.id else each
        for each in before
    )
    try:
        found = requested(pitch)
    finally:
        port.devices = before
    assert (found.cap, found.search.cap) == (cap, cap)


def test_a_joint_that_hangs_beyond_its_stop_within_the_margin_may_be_searched(yaw: Homed) -> None:
    count = int(yaw.loop.hardware.readings.raw.ticks[yaw.place])
    angle = (count - 1799) / RAD
    with described(yaw, stops=JointEndstops(lower=angle + 0.19)):
        found = requested(yaw)
    assert found.search.expected > count > found.lower


# ------------------------------------------------------------------------------- its turn unknown


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize(("angle", "ratio"), [(-0.6, 3.0), (0.8, 3.0), (0.1, 6.0)])
def test_a_joint_whose_turn_is_unknown_is_searched_from_the_turn_furthest_from_its_stop(
    tmp_path_factory: pytest.TempPathFactory, side: str, angle: float, ratio: float
) -> None:
    counts = ratio * RAD
    with started(long_waist_in(tmp_path_factory.mktemp("waist"), ratio), angle) as rig:
        place = rig.names.index(WAIST)
        rig.place = place  # type: ignore[attr-defined]
        found = requested(rig, side)
        turns = rig.loop.robot.joints.turns
        raw = int(rig.loop.hardware.readings.raw.ticks[place])
        _, row, bus = place_on_bus(rig.loop, place)
    first, last, room = (int(each[place]) for each in (turns.first, turns.last, turns.room))
    way = -1 if side == "upper" else 1  # its counts grow downwards
    fits = [turn * 4096 for turn in range(-4, 5) if first - room <= raw + turn * 4096 <= last + room]
    assert found.shift == (min(fits) if way > 0 else max(fits)) and len(fits) >= 2
    search = found.search
    assert search.way == way and search.turn == 4096.0
    assert search.margin == pytest.approx(min(0.2 * counts, 4096 / 8))
    away = last - first - 4096 + room + search.margin + search.back
    assert search.away == pytest.approx(away)
    end = search.expected + way * search.margin
    furthest = search.expected - way * (max(fits) - min(fits) + search.margin + away + search.still)
    assert sorted((found.lower, found.upper)) == [
        floor(min(end, furthest)) - 1,
        ceil(max(end, furthest)) + 1,
    ]
    stop = STOP if side == "upper" else -STOP
    assert search.expected == pytest.approx(bus.zero[row] + stop / bus.scale[row])


def test_a_turn_that_no_way_from_the_stop_proves_is_refused(tmp_path: Any) -> None:
    with started(long_waist_in(tmp_path, 6.0), 0.1) as rig:
        made: Any = rig
        made.place = rig.names.index(WAIST)
        made.spec = rig.robot.joints[made.place]
        turns = rig.loop.robot.joints.turns
        room = int(turns.room[made.place])
        span = float(turns.last[made.place] - turns.first[made.place])
        most = 4096 - room - 2 * 512  # counts that it may back off, so that its way is within its travel
        for more, allowed in ((-1, True), (1, False)):
            with described(made, lower=-STOP + (most + more) / (6.0 * RAD) - 0.02):
                found = resolve(made)
            assert isinstance(found, HomingRequest) is allowed, found
    [finding] = found
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, made.place)
    assert finding.bound == span - 512 and finding.value == pytest.approx(span - 512 + 1)
    assert "`twindctl calibrate turn --pose`" in finding.message


# ------------------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    ("how", "value", "bound", "what"),
    [
        ({"current_share": 0.16}, 0.16, 0.15, "current_share of the current limit"),
        ({"current_share": 0.02}, 0.02, 0.03, "current_share of the current limit"),
        ({"speed": 0.51}, 0.51, 0.5, "speed, rad/s"),
        ({"speed": 0.01}, 0.01, 0.02, "speed, rad/s"),
        ({"speed": inf}, inf, 0.5, "speed, rad/s"),
        ({"times": 1}, 1.0, 2.0, "times"),
        ({"times": 11}, 11.0, 10.0, "times"),
    ],
)
def test_a_number_out_of_bounds_is_refused_with_the_bound(
    yaw: Homed, how: dict[str, Any], value: float, bound: float, what: str
) -> None:
    [finding] = refused(yaw, **how)
    assert finding == Finding(ReasonCode.BAD_SCHEMA, value=value, bound=bound, message=what)
    assert isinstance(finding.value, float) and isinstance(finding.bound, float)


def test_a_number_that_is_none_is_refused(yaw: Homed) -> None:
    [finding] = refused(yaw, speed=nan)
    assert finding.code == ReasonCode.BAD_SCHEMA and finding.bound == 0.02


def test_all_reasons_are_given_at_once(yaw: Homed) -> None:
    with described(yaw, stops=JointEndstops(upper=1.6), transmission="waist"):
        found = refused(yaw, client=OTHER, times=1)
    codes = [each.code for each in found]
    assert codes == [
        ReasonCode.BAD_SCHEMA,
        ReasonCode.LEASE_MISSING,
        ReasonCode.STOP_NOT_FOUND,
        ReasonCode.STOP_NOT_FOUND,
    ]
    assert [each.joint for each in found[2:]] == [yaw.place] * 2


@contextmanager
def at(made: Homed, period: float) -> Iterator[None]:
    before = made.loop.robot.period
    redescribe(made.loop, period=period)
    try:
        yield
    finally:
        redescribe(made.loop, period=before)


@contextmanager
def torque(made: Homed, place: int, value: int) -> Iterator[None]:
    slow = made.loop.hardware.slow.torque
    before = int(slow[place])
    slow[place] = value
    try:
        yield
    finally:
        slow[place] = before


AGAINST: Mapping[str, tuple[Callable[[Homed], Any], ReasonCode, str]] = {
    "torque elsewhere": (lambda made: torque(made, 5, 1), ReasonCode.TORQUE_MISMATCH, "is on somewhere"),
    "torque unread": (lambda made: torque(made, 5, -1), ReasonCode.TORQUE_MISMATCH, "or not known yet"),
    "no stop": (
        lambda made: described(made, stops=JointEndstops(upper=1.6)),
        ReasonCode.STOP_NOT_FOUND,
        "the robot file has no stop_rad.lower of it: the position of that stop is unknown",
    ),
    "turned by several": (
        lambda made: described(made, transmission="waist"),
        ReasonCode.STOP_NOT_FOUND,
        "transmission waist turns it: its stop is not that of one actuator",
    ),
    "a slow loop": (
        lambda made: at(made, 0.026),
        ReasonCode.STOP_NOT_FOUND,
        "the loop runs at 38.4615 Hz, and a search needs 40 Hz",
    ),
}


@pytest.mark.parametrize("name", AGAINST)
def test_a_reason_against_a_search_names_the_joint(yaw: Homed, name: str) -> None:
    wrong, code, text = AGAINST[name]
    with wrong(yaw):
        [finding] = refused(yaw)
    assert (finding.code, finding.joint) == (code, yaw.place)
    assert text in finding.message


def test_a_loop_of_forty_hertz_is_fast_enough(yaw: Homed) -> None:
    with at(yaw, 0.025):
        requested(yaw)


@pytest.mark.parametrize(("beyond", "allowed"), [(0.19, True), (0.21, False)])
def test_a_joint_that_stands_beyond_where_the_stop_should_be_is_refused(
    yaw: Homed, beyond: float, allowed: bool
) -> None:
    count = int(yaw.loop.hardware.readings.raw.ticks[yaw.place])
    stop = (count - 1799) / RAD + beyond
    with described(yaw, stops=JointEndstops(lower=stop)):
        found = resolve(yaw)
    if allowed:
        assert isinstance(found, HomingRequest)
        return
    [finding] = found
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, yaw.place)
    assert finding.value == pytest.approx(beyond * RAD) and finding.bound == pytest.approx(0.2 * RAD)
    assert "beyond where the stop should be" in finding.message


def test_a_joint_that_is_not_verified_is_refused(yaw: Homed, monkeypatch: pytest.MonkeyPatch) -> None:
    verified = yaw.loop.identity.verified
    none = verified.joints & False
    monkeypatch.setattr(type(verified), "joints", property(lambda _: none))
    assert [each.code for each in refused(yaw, client=OTHER)] == [ReasonCode.LEASE_MISSING]
    [finding] = refused(yaw)
    assert finding.code == ReasonCode.CALIB_MISMATCH and finding.joint == yaw.place
    assert finding.message == "not verified since its bus was identified: `twindctl status`"


def test_an_unidentified_bus_is_refused(yaw: Homed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(yaw.loop.hardware), "connected", False)
    found = refused(yaw)
    assert Finding(ReasonCode.HW_DISCONNECTED, message="not every bus is open and identified") in found
    assert "not verified" not in "".join(each.message for each in found)


@pytest.mark.parametrize("support", ["free", "gantry", "fixed"])
def test_a_leg_of_a_robot_that_stands_freely_is_refused(support: str) -> None:
    with homed(joint="l_knee", support=support, start={}) as made:
        made.ready()
        found = resolve(made)
        arm = resolve(made, joint=made.names.index(JOINT))
    assert isinstance(arm, HomingRequest)
    if support != "free":
        assert isinstance(found, HomingRequest)
        return
    [finding] = found
    assert finding.joint == made.place and finding.message == (
        "it carries a robot that stands freely: hang the robot up and set support: gantry"
    )


def test_an_actuator_that_has_no_capped_mode_is_refused() -> None:
    name = next(joint.name for joint in load_robot("h24-mixed").joints if joint.type.BUS == "can")
    with homed(joint=name, robot="h24-mixed", start={}) as made:
        made.connect()
        made.lease()
        assert made.call(link.Calibrate, on=True).error is None
        texts = [each.message for each in refused(made) if each.joint == made.place]
    device = made.spec.type.device
    assert f"a {device} is not driven against a stop: move it there by hand, and sweep it" in texts


def test_a_type_without_a_limit_of_current_is_refused(yaw: Homed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(yaw.spec.type), "full_effort", inf)
    [finding] = refused(yaw)
    assert finding.message == (
        "its type has no current_limit_a, or reports no current: there is nothing to cap"
    )


@pytest.mark.parametrize("hot", [JOINT, PITCH])
def test_a_hot_servo_is_not_driven_but_may_be_a_neighbour(
    yaw: Homed, hot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    warm = yaw.loop.hardware.slow.temperature.copy()
    warm[yaw.names.index(hot)] = 200.0
    gate_input = type(yaw.loop.commands.gate_input)
    before = gate_input.snapshot

    def heated(*how: Any) -> Any:
        snapshot = before(*how)
        return replace(snapshot, condition=replace(snapshot.condition, temperature=warm))

    monkeypatch.setattr(gate_input, "snapshot", heated)
    found = resolve(yaw)
    if hot == PITCH:
        assert isinstance(found, HomingRequest)
        return
    [finding] = found
    assert (finding.code, finding.joint) == (ReasonCode.THERMAL_HEADROOM, yaw.place)


def test_of_other_joints_only_their_torque_matters(yaw: Homed, monkeypatch: pytest.MonkeyPatch) -> None:
    other = Finding(ReasonCode.CALIB_MISMATCH, yaw.place + 1, message="another joint")
    mine = Finding(ReasonCode.CALIB_MISMATCH, yaw.place, message="this joint")
    whole = Finding(ReasonCode.CALIB_MISMATCH, message="a file")
    gate_input = type(yaw.loop.commands.gate_input)
    before = gate_input.snapshot
    monkeypatch.setattr(
        gate_input,
        "snapshot",
        lambda *how: replace(before(*how), mismatches=(other, mine, whole)),
    )
    assert refused(yaw) == [mine, whole]


# ------------------------------------------------------------------------------- turns of another mode


@pytest.mark.parametrize(("before", "raw", "shift"), [(100, 100, 0), (100, 4196, -4096), (5000, 650, 4096)])
def test_another_mode_counts_whole_turns_off(before: int, raw: int, shift: int) -> None:
    assert turns_between(before, raw, 4096) == shift


@pytest.mark.parametrize("off", [256, -256])
def test_a_sixteenth_of_a_turn_is_no_other_offset(off: int) -> None:
    assert turns_between(1000, 1000 + off, 4096) == 0
    with pytest.raises(ProcedureFailed) as failed:
        turns_between(1000, 1000 + off + (1 if off > 0 else -1), 4096)
    finding = failed.value.finding
    assert (finding.code, finding.value, finding.bound) == (ReasonCode.CALIB_MISMATCH, 257.0, 256.0)
    assert "no whole turn" in finding.message


def test_a_joint_is_found_at_its_place_of_its_bus(yaw: Homed) -> None:
    number, row, bus = place_on_bus(yaw.loop, yaw.place)
    assert bus is yaw.loop.robot.joints.buses[number] and bus.ids[row] == yaw.spec.id
    with pytest.raises(KeyError):
        place_on_bus(yaw.loop, 99)
