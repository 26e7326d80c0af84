"""The monitor of a CAN bus, beside what wrong daemons prove: text, fields, golden frames, files."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proof.busmon.bus import limits_of, monitor_of, port_baud
from tests.proof.busmon.can.acts import Act, MotorReply
from tests.proof.busmon.can.mit import Mit
from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.can.motors import FIELD, TURN, CanLimits, motor, word
from tests.proof.busmon.can.odrive import ODrive
from tests.proof.busmon.can.read import is_can, read
from tests.proof.busmon.can.robstride import RobStride
from tests.proof.busmon.can.text import Frame, Lines, Malformed, frame, set_up, text
from tests.proof.evil import can_world
from tests.proof.evil.can_good import Good
from tests.proof.evil.can_nodes import ODRIVE, reply_frame

ENDS = (-1.0, 1.0)


def mit(family: str = "damiao", spans: tuple[float, float, float] = (12.5, 30.0, 10.0)) -> Mit:
    return Mit([motor(1, "knee", family, spans, ENDS, 4.0, 20.0, reply=0x11)])


def act(family: Mit | RobStride | ODrive, line: bytes) -> Act:
    found = family.command(frame(line))
    assert found is not None
    return found


# ----------------------------------------------------------------------------------------------- text


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_every_frame_is_read_as_it_is_written(id: int, data: bytes, small: bool) -> None:
    text = f"t{id:03X}{len(data)}{data.hex()}"
    assert frame((text if small else text[0] + text[1:].upper()).encode()) == Frame(id, False, False, data)


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_every_extended_frame_likewise(id: int, data: bytes) -> None:
    assert frame(f"T{id:08x}{len(data)}{data.hex()}".encode()) == Frame(id, True, False, data)


@given(st.integers(0, 0x1FFFFFFF), st.booleans(), st.booleans(), st.binary(max_size=8))
def test_frames_in_memory_become_the_lines_of_the_same_frames(
    id: int, extended: bool, remote: bool, data: bytes
) -> None:
    id = id if extended else id & 0x7FF
    data = b"" if remote else data
    flags = extended << 31 | remote << 30
    kept = (id | flags).to_bytes(4, "little") + bytes((len(data), 0, 0, 0)) + data.ljust(8, b"\0")
    [line, rest] = text(kept).split(b"\r")
    assert (frame(line), rest) == (Frame(id, extended, remote, data), b"")
    assert text((1 << 29 | 4).to_bytes(4, "little") + bytes((8,)) + bytes(11)) == b""
    assert text(kept * 3) == text(kept) * 3


@pytest.mark.parametrize("line", [
    b"", b"t", b"t12", b"T1234567", b"t12G0", b"t1238AABB", b"t1239" + b"00" * 9, b"t12320AABB", b"x1230",
    b"t8000", b"T200000000", b"r0018AABBCCDDEEFF0011", b"\x80", b"t001 ", b"t0012AAB\xff", b"d0010",
])  # fmt: skip
def test_a_text_that_is_no_frame_is_refused(line: bytes) -> None:
    """Among them all that python-can takes (field manual, section 10)."""
    with pytest.raises(Malformed):
        frame(line)


@given(st.binary(max_size=200), st.integers(1, 50))
def test_any_bytes_in_any_pieces_are_cut_at_the_same_places(data: bytes, size: int) -> None:
    whole = Lines()
    pieces = Lines()
    cut = [line for at in range(0, len(data), size) for line in pieces.take(data[at : at + size])]
    assert (whole.take(data), whole.rest) == (cut, pieces.rest)
    assert b"\r" not in pieces.rest


@pytest.mark.parametrize(("line", "good"), [
    (b"", True), (b"C", True), (b"O", True), (b"S8", True), (b"F", True), (b"X", False), (b"t0010", False),
])  # fmt: skip
def test_adapter_setup_lines_are_accepted_or_rejected(line: bytes, good: bool) -> None:
    assert set_up(line, 1_000_000) is good


@pytest.mark.parametrize(("line", "baud"), [(b"S6", 1_000_000), (b"S8", 500_000), (b"S9", 1_000_000)])
def test_the_adapter_is_set_to_the_rate_of_the_bus_and_no_other(line: bytes, baud: int) -> None:
    with pytest.raises(Malformed, match=str(baud)):
        set_up(line, baud)


@given(st.binary(max_size=120))
def test_no_bytes_break_the_monitor(data: bytes) -> None:
    monitor = CanMonitor(can_world.LIMITS)
    for part in (data, b"\r" + data + b"\r", b"t001" + data + b"\r"):
        monitor.answered(part, 1.0)
        monitor.sent(part, 1.0)
        monitor.look(1.2)
    assert all(each.rule == "W8" for each in monitor.violations)


# ---------------------------------------------------------------------------------------------- golden frames


@pytest.mark.parametrize(("text", "place", "rate", "push"), [
    (b"8A3C7FF1993337FF", 1.0, 0.0, 0.0),
    (b"5FD49543337FF532", -3.14159, 5.0, -3.5),
])  # fmt: skip
def test_golden_commands_of_the_mit_frame(text: bytes, place: float, rate: float, push: float) -> None:
    """Field manual, section 2: ranges 12.5, 30, 10."""
    found = act(mit(), b"t0018" + text)
    assert (found.kind, found.id) == ("goal", 1)
    assert abs(found.word * 25.0 / FIELD - 12.5 - place) <= 25.0 / FIELD
    assert found.rate == pytest.approx(rate, abs=60.0 / 4095)
    assert found.push == pytest.approx(push, abs=20.0 / 4095)


def test_a_command_of_nothing_is_limp_and_no_goal() -> None:
    assert act(mit(), b"t00187FFF7FF0000007FF").kind == "limp"
    assert act(mit(), b"t00187FFF7FF0010007FF").kind == "goal"
    assert act(mit(), b"t00187FFF7FF000000900").kind == "soft"  # torque alone moves it too, but not there
    assert act(mit(), b"t00187FFF7FF0000107FF").kind == "soft"  # damped: its torque is not what it was
    cubemars = mit("cubemars")  # but where there is no other way to ask
    assert act(cubemars, b"t00187FFF7FF0000107FF").kind == "limp"
    assert act(cubemars, b"t00187FFF9000000107FF").kind == "soft"  # towards a speed


@pytest.mark.parametrize(
    ("last", "kind"), [(b"FC", "on"), (b"FD", "off"), (b"FB", "clear"), (b"FA", "wrong")]
)
def test_special_frames(last: bytes, kind: str) -> None:
    assert act(mit(), b"t0018FFFFFFFFFFFFFF" + last).kind == kind


def test_golden_frames_of_robstride() -> None:
    """Field manual, section 3: ranges 12.57, 33, 14, motor 7F."""
    family = RobStride([motor(0x7F, "hip", "robstride", (12.57, 33.0, 14.0), ENDS, 4.0, 20.0)])
    found = act(family, b"T017FFF7F88A2E7FFF19993333")
    assert (found.kind, found.id) == ("goal", 0x7F)
    assert abs(found.word * 25.14 / FIELD - 12.57 - 1.0) <= 25.14 / FIELD
    assert found.push == pytest.approx(0.0, abs=28.0 / FIELD)
    assert act(family, b"T0300FD7F8" + b"00" * 8).kind == "on"
    assert act(family, b"T0400FD7F8" + b"00" * 8).kind == "off"
    assert act(family, b"T0400FD7F801" + b"00" * 7).kind == "clear"
    assert act(family, b"T1100FD7F81970" + b"00" * 6).kind == "read"


def test_golden_frames_of_odrive() -> None:
    """Field manual, section 4: node 3, 1.5 turns, 0.25 rev/s, -0.1 N·m."""
    family = ODrive([motor(3, "arm", "odrive", (0.0, 20.0, 5.0), (-20.0, 20.0), 4.0, 20.0)])
    found = act(family, b"t06C80000C03FFA009CFF")
    assert (found.kind, found.word) == ("goal", 1.5 * TURN)
    assert found.rate == pytest.approx(0.25 * 2 * 3.14159265, rel=1e-6)
    assert found.push == pytest.approx(-0.1)
    assert act(family, b"t067408000000").kind == "on"
    assert act(family, b"t067401000000").kind == "off"
    assert act(family, b"r0690").kind == "read"


def test_an_acknowledgement_is_no_place() -> None:
    """Field manual, 2.3: on the master id it would decode to -12.468 rad."""
    assert mit().reply(frame(b"t0118010055091E000000")) is None
    assert mit().reply(frame(b"t01181100AA1000000000")) is not None  # its status nibble: feedback
    assert mit().reply(frame(b"t01180100330A01000000")) is None
    assert mit().reply(frame(b"t0118010033" + b"09" + b"D0070000")) == MotorReply(1, seconds=0.1)


def test_feedback_is_of_its_own_id_and_size_alone() -> None:
    assert mit().reply(frame(b"t01181180007FF7FF1E1F")) == MotorReply(1, 0x8000, True, False)
    assert mit().reply(frame(b"t0118B180007FF7FF1E1F")) == MotorReply(1, 0x8000, False, True)
    for line in (b"t01281180007FF7FF1E1F", b"t01181280007FF7FF1E1F", b"t01171180007FF7FF1E", b"r0110"):
        assert mit().reply(frame(line)) is None


# ----------------------------------------------------------------------------------------------- limits


@given(st.floats(0.5, 20.0), st.floats(-0.99, 0.99))
def test_a_word_is_what_its_field_decodes_to(span: float, share: float) -> None:
    angle = share * span
    field = int(word("damiao", span, angle))
    assert abs(field * 2.0 * span / FIELD - span - angle) <= 2.0 * span / FIELD + 1e-9


@pytest.mark.parametrize("over", [
    {"family": "moteus"}, {"ends": (1.0, 1.0)}, {"rate": 0.0}, {"acceleration": 0.0},
    {"spans": (-1.0, 1.0, 1.0)},
])  # fmt: skip
def test_limits_that_make_no_sense_are_refused(over: dict[str, object]) -> None:
    usual = {"family": "damiao", "spans": (12.5, 30.0, 10.0), "ends": ENDS, "rate": 1.0, "acceleration": 1.0}
    with pytest.raises((ValueError, ZeroDivisionError)):
        motor(1, "x", **(usual | over))  # type: ignore[arg-type]


ROBOT = """
name: leg
support: fixed
loop: {rate_hz: 200}
buses: {leg: {kind: can, bitrate: 500000}, arm: {kind: dynamixel2, baud: 1000000}}
types:
  dm: {device: DM4310, gains: {kp: 1, kd: 1}, ranges: {position_rad: 12.5, velocity_rad_s: 30, torque_nm: 10},
       velocity_limit_rad_s: 4.0, acceleration_limit_rad_s2: 20.0}
defaults: {type: dm, bus: leg}
joints:
  hip: {id: 1, limits_rad: [-0.5, 1.0], ratio: 2.0, sign: -1}
  knee: {id: 2, limits_rad: [-0.5, 1.0], feedback_id: 99, velocity_limit_rad_s: 1.0}
"""
MEASURED = """
joints:
  hip: {id: 1, sign: -1, zero_ticks: 1000, sweep_ticks: [-9000, 9000]}
  knee: {id: 2, sign: 1, zero_ticks: 0, sweep_ticks: [-1000, 9000]}
"""


def files(folder: Path, robot: str = ROBOT) -> tuple[Path, Path]:
    (folder / "leg.yaml").write_text(robot)
    (folder / "calibration.yaml").write_text(MEASURED)
    return folder / "leg.yaml", folder / "calibration.yaml"


def test_limits_come_from_the_two_files(tmp_path: Path) -> None:
    robot, calibration = files(tmp_path)
    assert is_can(robot, "leg")
    assert not is_can(robot, "arm")
    limits = limits_of(robot, calibration, "leg")
    assert isinstance(limits, CanLimits)
    assert isinstance(monitor_of(limits), CanMonitor)
    assert (limits.period, limits.baud, limits.support) == (0.005, 500_000, "fixed")
    assert port_baud(limits) == 1_000_000
    hip = limits.servos[1]
    knee = limits.servos[2]
    each = FIELD / 25.0
    count = 2.0 * 3.141592653589793 / TURN
    assert (hip.reply, knee.reply) == (0x11, 99)
    assert hip.lower == pytest.approx((12.5 + 1000 * count - 2.1) * each, abs=1)
    assert hip.upper == pytest.approx((12.5 + 1000 * count + 1.1) * each, abs=1)
    assert hip.speed == pytest.approx(4.0 * each)  # at the motor
    assert knee.lower == pytest.approx(
        (12.5 - 1000 * count) * each, abs=1
    )  # it was measured to reach no further
    assert knee.speed == pytest.approx(1.0 * each)
    assert knee.brake == pytest.approx(20.0 * each)


@pytest.mark.parametrize(("old", "new", "what"), [
    ("DM4310", "XM430", "family"), ("sign: -1", "sign: 1", "another motor"),
    ("id: 2,", "id: 3,", "another motor"), ("[-0.5, 1.0], ratio", "[1.0, 1.0], ratio", "limits"),
    ("rate_hz: 200", "rate_hz: 0.5", "rate"), ("ratio: 2.0", "ratio: 0.0", "ratio"),
    ("velocity_limit_rad_s: 4.0", "velocity_limit_rad_s: 0.0", "velocity"),
])  # fmt: skip
def test_a_file_that_makes_no_sense_is_refused(tmp_path: Path, old: str, new: str, what: str) -> None:
    assert old in ROBOT
    with pytest.raises(ValueError, match=what):
        read(*files(tmp_path, ROBOT.replace(old, new, 1)), "leg")
    with pytest.raises(ValueError, match="no motor"):
        read(*files(tmp_path), "arm")


# ----------------------------------------------------------------------------------------------- time


def test_a_late_word_explains_what_left_before_it() -> None:
    """A goal that is said to be one of an armed robot soon after it left is none of W5."""
    port = can_world.VirtualPort()
    port.monitor = CanMonitor(can_world.LIMITS, hearsay=0.1)
    good = Good(port, can_world.LIMITS)
    port.say("mode", mode="live")
    port.say("state", state="connected")
    good.idle(2)
    good.exchange(good.limp() + good.question())
    port.write(good.aim(good.present()))
    port.until(port.now + 0.05)
    port.say("state", state="armed")
    port.until(port.now + 0.3)
    assert not port.monitor.violations
    port.say("state", state="connected")
    good.exchange(good.limp() + good.question())
    port.write(good.aim(good.present()))
    port.until(port.now + 0.3)
    assert {each.rule for each in port.monitor.violations} == {"W5"}


def test_a_gap_of_the_monitors_own_is_no_silence() -> None:
    port = can_world.VirtualPort()
    good = Good(port, can_world.LIMITS)
    good.connect()
    good.arm()
    port.now += 0.5
    port.say("blind")
    good.tick = port.now
    good.move(2.0)
    assert not port.monitor.violations


# --------------------------------------------------------------------------- goals of motors that stopped


class ArmedCan(Good):
    """The right daemon, armed and holding."""

    def __init__(self) -> None:
        self.world = can_world.VirtualPort()
        super().__init__(self.world, can_world.LIMITS)
        self.connect()
        self.arm()
        self.hold(3)
        assert not self.rules

    @property
    def rules(self) -> set[str]:
        return {violation.rule for violation in self.world.monitor.violations}

    def heartbeat(self, state: int) -> None:
        """The ODrive reports its axis state."""
        line = reply_frame(ODRIVE << 5 | 1, bytes(4) + bytes((state, 0, 0, 0)))
        self.world.monitor.answered(line, self.port.now)


@pytest.mark.parametrize(("command", "wrong"), [(0x1A, False), (0x1B, False), (0x0F, True)])
def test_gains_of_an_odrive_are_its_stiffness_also_under_torque_and_its_limits_are_not(
    command: int, wrong: bool
) -> None:
    daemon = ArmedCan()
    daemon.exchange(reply_frame(ODRIVE << 5 | command, bytes(4 if command == 0x1A else 8)))
    assert daemon.rules == ({"W2"} if wrong else set())


@pytest.mark.parametrize("off", range(-4, 5))
@pytest.mark.parametrize("ticks", [5, 15])
def test_after_a_silence_a_motor_is_aimed_where_it_was_read_and_nowhere_else(ticks: int, off: int) -> None:
    """W6 counts the step from there, at rest a word at most; after 50 ms still from the old goal."""
    daemon = ArmedCan()
    node = daemon.world.nodes.nodes[ODRIVE]
    node.place += 30
    node.goal = None
    daemon.idle(ticks)
    assert daemon.here[ODRIVE] - daemon.goals[ODRIVE] >= 29
    daemon.port.say("estop", level="settle")
    daemon.port.say("state", state="estop")
    daemon.cycle(daemon.goals | {ODRIVE: daemon.here[ODRIVE] + off})
    assert daemon.rules == (set() if ticks > 10 and abs(off) <= 1 else {"W6"})


@pytest.mark.parametrize(("off", "wrong"), [(0, False), (300, True)])
def test_a_motor_without_torque_follows_no_goal_and_with_torque_its_first_is_where_it_is(
    off: int, wrong: bool
) -> None:
    daemon = ArmedCan()
    here = daemon.here[ODRIVE]
    daemon.heartbeat(1)
    daemon.world.nodes.nodes[ODRIVE].on = False
    daemon.cycle(daemon.goals | {ODRIVE: here + 400})
    assert not daemon.rules
    daemon.heartbeat(8)
    daemon.cycle(daemon.goals | {ODRIVE: here + off})
    assert daemon.rules == ({"W3"} if wrong else set())
