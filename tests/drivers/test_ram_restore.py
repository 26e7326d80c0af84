"""A restart gives the RAM settings back, never the torque, and is refused for a servo that carries a load."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_responder import Servos
from tests.support.dynamixel_rig import Bench
from tests.support.examples import examples
from twind_drivers.bus import DeviceRefused, NoReply
from twind_drivers.device_registers import RestartResult
from twind_drivers.dynamixel.packet import Instruction, Packet
from twind_drivers.dynamixel.ram_restore import RESTORED
from twind_drivers.dynamixel.register_rules import rule

HERE = 2
# e-manual, RAM area of the XM430-W350: what a restart leaves in these registers (address: value, size)
DEFAULTS = {
    64: (0, 1), 65: (0, 1), 68: (2, 1), 70: (0, 1), 76: (1920, 2), 78: (100, 2), 80: (0, 2), 82: (0, 2),
    84: (800, 2), 88: (0, 2), 90: (0, 2), 98: (0, 1), 100: (885, 2), 102: (1193, 2), 104: (0, 4), 108: (0, 4),
    112: (0, 4), 116: (2048, 4),
}  # fmt: skip
KEYS = {
    "led": (65, 1), "status_return_level": (68, 1), "velocity_i_gain": (76, 2), "velocity_p_gain": (78, 2),
    "position_d_gain": (80, 2), "position_i_gain": (82, 2), "position_p_gain": (84, 2),
    "feedforward_2nd_gain": (88, 2), "feedforward_1st_gain": (90, 2), "goal_pwm": (100, 2),
    "goal_current": (102, 2), "profile_acceleration": (108, 4), "profile_velocity": (112, 4),
}  # fmt: skip


class Restarting(Servos):
    """A restart empties the RAM as a servo does; in `boots_with` registers that then read otherwise."""

    def __init__(self, ids: Sequence[int]) -> None:
        super().__init__(ids)
        self.boots_with: dict[int, tuple[int, int]] = {}
        self.broken: set[int] = set()  # addresses that ignore writes after the restart
        self.lost: list[Instruction] = []  # the next of these does not arrive
        self.tells = True  # a restart has a status
        self.boot = 0  # pings without reply after a restart

    def _single(self, each: Packet) -> bytes:
        if each.instruction in self.lost:
            self.lost.remove(Instruction(each.instruction))
            return b""
        answer = super()._single(each)
        if each.instruction == Instruction.REBOOT and each.id in self.memory:
            for address, (value, size) in (DEFAULTS | self.boots_with).items():
                self.put(each.id, address, value, size)
            self.frozen[each.id] = self.broken
            self.deaf_until[each.id] = self.boot
            return answer if self.tells else b""
        return answer

    def count(self, instruction: Instruction) -> int:
        return [each.instruction for each in self.seen].count(instruction)


def bench(mode: int = 3) -> Bench:
    bus = Bench(
        kind=Restarting,
        modes=[3, mode, 3],
        current_caps=[None, 500 if mode == 5 else None, None],
        lower=np.array([1000, -1000, 1000]),
        upper=np.array([3000, 1000, 3000]),
    )
    for id in bus.ids:
        for address, (value, size) in DEFAULTS.items():
            bus.servos.put(id, address, value, size)
    return bus


def reboot(bus: Bench, **more: bool) -> RestartResult:
    found: RestartResult = bus.run(bus.writer.reboot(HERE, **more))
    return found


def values(draw: st.DrawFn) -> dict[str, int]:
    found = {}
    for name in KEYS:
        each = rule("xm430_w350", name)
        low = each.lower or 0
        high = each.upper or 0
        found[name] = draw(st.integers(max(low, 0) if name == "goal_current" else low, high))
    return {**found, "status_return_level": draw(st.sampled_from([1, 2]))}  # at 0 nobody can read it


@given(st.composite(values)())
@examples(40)
def test_every_setting_comes_back_and_neither_torque_nor_goal_nor_watchdog(wanted: dict[str, int]) -> None:
    bus = bench()
    for name, (address, size) in KEYS.items():
        bus.servos.put(HERE, address, wanted[name], size)
    bus.servos.put(HERE, 116, 1234, 4)
    bus.servos.put(HERE, 98, 5, 1)
    found = reboot(bus)
    assert {name: bus.servos.get(HERE, *where) for name, where in KEYS.items()} == wanted
    assert (bus.servos.get(HERE, 64, 1), bus.servos.get(HERE, 98, 1)) == (0, 0)
    assert bus.servos.get(HERE, 116, 4) == DEFAULTS[116][0]
    assert found.differing == ()
    changed = {name for name, (address, _) in KEYS.items() if DEFAULTS[address][0] != wanted[name]}
    assert {each.address for each in found.restored} == {KEYS[name][0] for name in changed}


def test_values_read_before_a_reboot_are_unknown_after_it() -> None:
    bus = bench()
    bus.run(bus.reader.collect(bus.ids, 120, 27))
    known = bus.reader.registers
    place = bus.ids.index(HERE)
    assert (known.tick >= 0).all()
    reboot(bus)
    assert known.tick[place] == -1
    assert np.isnan(known.voltage[place])
    assert np.isfinite(known.health_time).sum() == len(bus.ids) - 1


def test_the_restored_registers_are_exactly_the_tested_ones() -> None:
    of_a_y = {"velocity_ff_gain", "position_ff_gain", "profile_acceleration_time", "profile_time"}
    assert set(KEYS) | {"led_red", "led_green", "led_blue"} | of_a_y == set(RESTORED)


def test_a_servo_with_torque_is_not_restarted() -> None:
    bus = bench()
    bus.servos.put(HERE, 64, 1, 1)
    bus.servos.put(HERE, 84, 640, 2)
    with pytest.raises(DeviceRefused, match=r"id 2: reboot: its torque is on.*disarm, then reboot"):
        reboot(bus)
    assert Instruction.REBOOT not in [each.instruction for each in bus.servos.seen]
    assert bus.servos.get(HERE, 84, 2) == 640


@pytest.mark.parametrize(("error", "shutdown"), [(0, 0x34), (0x01, 0x34), (0x20, 0x14), (0x20, 0)])
def test_a_restart_as_shut_down_is_refused_without_an_error_that_shuts_down(
    error: int, shutdown: int
) -> None:
    # e-manual, Shutdown (63): only an error that is set there clears torque; then only a reboot restores it
    bus = bench()
    bus.servos.put(HERE, 64, 1, 1)
    bus.servos.put(HERE, 63, shutdown, 1)
    bus.servos.put(HERE, 70, error, 1)
    words = (
        rf"id 2: reboot: its torque is on and its hardware error \(70\) is {error}: nothing has shut it down"
    )
    with pytest.raises(DeviceRefused, match=words):
        reboot(bus, shut_down=True)
    assert bus.servos.count(Instruction.REBOOT) == 0


def test_a_restart_as_shut_down_is_done_for_one_error_of_those_that_shut_down() -> None:
    bus = bench()
    bus.servos.put(HERE, 64, 1, 1)
    bus.servos.put(HERE, 63, 0x34, 1)
    bus.servos.put(HERE, 70, 0x21, 1)
    reboot(bus, shut_down=True)
    assert (bus.servos.get(HERE, 64, 1), bus.servos.get(HERE, 70, 1)) == (0, 0)


def test_a_servo_shut_down_by_its_hardware_error_is_restarted_as_it_is() -> None:
    bus = bench()
    bus.servos.put(HERE, 70, 0x20, 1)
    bus.servos.error = {HERE: 0x80}  # alert in every status until the restart
    bus.servos.put(HERE, 84, 640, 2)
    assert [each.value for each in reboot(bus).restored] == [640]


def test_torque_that_a_start_switched_on_is_off_again() -> None:
    # e-manual, Startup Configuration (60), bit 0: torque on at boot
    bus = bench()
    bus.servos.boots_with = {64: (1, 1), 98: (5, 1)}
    reboot(bus)
    assert (bus.servos.get(HERE, 64, 1), bus.servos.get(HERE, 98, 1)) == (0, 0)
    bus.servos.broken = {64}
    with pytest.raises(DeviceRefused, match=r"Torque Enable \(64\): reads 1 .*cut its supply"):
        reboot(bus)


def test_a_register_that_is_not_restored_is_reported_with_both_values() -> None:
    bus = bench()
    bus.servos.put(HERE, 84, 640, 2)
    bus.servos.put(HERE, 65, 1, 1)
    bus.servos.broken = {84, 85}
    found = reboot(bus)
    assert [(each.name, each.value, was) for each, was in found.differing] == [("Position P Gain", 800, 640)]
    assert [(each.name, each.value) for each in found.restored] == [("LED", 1)]


@pytest.mark.parametrize("changed", [{}, {84: 640}, {84: 640, 65: 1}])
def test_only_the_registers_that_a_restart_changed_are_written(changed: dict[int, int]) -> None:
    bus = bench()
    for address, value in changed.items():
        bus.servos.put(HERE, address, value, 1 if address == 65 else 2)
    assert {each.address for each in reboot(bus).restored} == set(changed)
    assert bus.servos.count(Instruction.WRITE) == len(changed)


def test_a_current_that_is_a_goal_is_not_given_back() -> None:
    bus = bench(mode=0)
    bus.servos.put(HERE, 102, 300, 2)
    reboot(bus)
    assert bus.servos.get(HERE, 102, 2) == DEFAULTS[102][0]


@pytest.mark.parametrize("mode", [1, 3, 4])
def test_a_current_goal_that_is_no_cap_is_reported_and_left(mode: int) -> None:
    bus = bench(mode)
    bus.servos.put(HERE, 102, -300, 2)
    (differing,) = reboot(bus).differing
    assert (differing[0].name, differing[0].value, differing[1]) == ("Goal Current", 1193, -300)


@pytest.mark.parametrize(("stood", "stands"), [(400, 400), (500, 500), (501, 1193), (-1, 1193)])
def test_a_cap_comes_back_only_within_the_cap_of_its_mode(stood: int, stands: int) -> None:
    bus = bench(mode=5)
    bus.servos.put(HERE, 102, stood, 2)
    found = reboot(bus)
    assert bus.servos.get(HERE, 102, 2) == stands
    assert [was for _, was in found.differing] == ([] if stood == stands else [stood])


def test_one_lost_order_does_not_leave_on_the_torque_of_a_start() -> None:
    bus = bench()
    bus.servos.boots_with = {64: (1, 1)}
    bus.servos.lost = [Instruction.WRITE]
    reboot(bus)
    assert bus.servos.get(HERE, 64, 1) == 0


def test_a_servo_that_does_not_switch_off_its_torque_gets_two_orders() -> None:
    bus = bench()
    bus.servos.boots_with = {64: (1, 1)}
    bus.servos.broken = {64}
    with pytest.raises(DeviceRefused, match="cut its supply"):
        reboot(bus)
    assert bus.servos.count(Instruction.WRITE) == 2


# e-manual, Status Return Level (68): at 1 a servo replies to pings and reads alone
@pytest.mark.parametrize("boot", [2, 299])
def test_settings_come_back_after_a_restart_without_status(boot: int) -> None:
    bus = bench()
    bus.servos.tells = False
    bus.servos.boot = boot
    bus.servos.put(HERE, 84, 640, 2)
    assert [each.value for each in reboot(bus).restored] == [640]
    assert bus.servos.get(HERE, 84, 2) == 640
    assert bus.servos.count(Instruction.REBOOT) == 1
    assert bus.servos.count(Instruction.PING) == boot + 1


def test_a_restart_with_a_status_is_not_repeated() -> None:
    bus = bench()
    reboot(bus)
    assert (bus.servos.count(Instruction.REBOOT), bus.servos.count(Instruction.PING)) == (1, 1)


def test_a_restart_that_did_not_arrive_is_ordered_again() -> None:
    bus = bench()
    bus.servos.lost = [Instruction.REBOOT]
    bus.servos.put(HERE, 84, 640, 2)
    bus.servos.put(HERE, 116, 1234, 4)
    assert [each.value for each in reboot(bus).restored] == [640]
    assert bus.servos.get(HERE, 116, 4) == DEFAULTS[116][0]


def test_one_ping_without_reply_is_no_sign_of_a_restart() -> None:
    bus = bench()
    bus.servos.lost = [Instruction.REBOOT, Instruction.PING]
    bus.servos.put(HERE, 84, 640, 2)
    bus.servos.put(HERE, 116, 1234, 4)
    assert [each.value for each in reboot(bus).restored] == [640]
    assert bus.servos.count(Instruction.REBOOT) == 2
    assert bus.servos.get(HERE, 116, 4) == DEFAULTS[116][0]


def test_a_servo_that_never_restarts_is_no_reply_and_keeps_its_settings() -> None:
    bus = bench()
    bus.servos.lost = [Instruction.REBOOT] * 2
    bus.servos.put(HERE, 84, 640, 2)
    begun = bus.clock.now()
    with pytest.raises(NoReply, match=r"no reply to reboot from \[2\]") as error:
        reboot(bus)
    assert error.value.waited == pytest.approx(bus.clock.now() - begun)
    assert bus.servos.get(HERE, 84, 2) == 640


def test_a_servo_that_does_not_come_back_is_no_reply() -> None:
    bus = bench()
    bus.servos.boot = 300
    bus.run(bus.reader.collect(bus.ids, 120, 27))
    begun = bus.clock.now()
    with pytest.raises(NoReply, match=r"no reply to 300 pings after a reboot from \[2\]") as error:
        reboot(bus)
    assert error.value.waited == pytest.approx(bus.clock.now() - begun)
    assert bus.reader.registers.tick[bus.ids.index(HERE)] == -1
    assert bus.servos.count(Instruction.PING) == 300
    with pytest.raises(KeyError, match="has no id 9"):
        bus.run(bus.writer.reboot(9))
