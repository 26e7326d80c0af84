"""Boots, turns and offsets: e-manual, "Operating Mode" note, "Homing Offset", "Startup Configuration"."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Instruction

STORE = bytes.fromhex("01 43 54 52 4C")


def reboot(host: Host, id: int = 1) -> None:
    host.ask(packet.reboot(id))
    host.wait(0.15)


# ---------------------------------------------------------------------- homing offset


def test_an_offset_beyond_1024_may_fall_back_to_0() -> None:
    """ROBOTIS forum 5477: 2900 written in mode 3 read back as 0. Others keep it (the default)."""
    for forgets, kept in ((False, 2900), (True, 0)):
        host = Host([1], forgets_offset=forgets)
        assert host.write(1, 20, 2900, 4) == 0
        assert (host.read(1, 20, 4), host.present(1)) == (kept, 2048)
        host.write(1, 20, -1024, 4)
        assert (host.read(1, 20, 4), host.present(1)) == (-1024, 1024), "inside it counts"


def test_an_offset_that_counts_in_mode_4_falls_back_when_the_mode_becomes_3() -> None:
    host = Host([1], settings={"operating_mode": 4, "homing_offset": 5000}, forgets_offset=True)
    assert (host.present(1), host.read(1, 20, 4)) == (7048, 5000)
    host.write(1, 11, 3, 1)
    assert (host.present(1), host.read(1, 20, 4)) == (2048, 0)


@given(st.integers(-1024, 1024))
@examples(30)
def test_reverse_turns_the_count_and_not_the_offset(offset: int) -> None:
    """e-manual, "Homing Offset" note; dynamixel_hardware_interface #97."""
    host = Host([1], settings={"homing_offset": offset, "operating_mode": 4}, start=100.0)
    assert host.present(1) == 100 + offset
    host.write(1, 10, 1, 1)
    assert host.present(1) == -100 + offset


# ---------------------------------------------------------------------- turns


@given(st.integers(-30_000, 30_000), st.sampled_from([1, 3, 4, 5, 16]))
@examples(40)
def test_a_boot_leaves_one_turn_in_every_mode(turned: int, mode: int) -> None:
    """e-manual, operating mode note, case 3: power-up and reboot."""
    host = Host([1], settings={"operating_mode": mode}, start=0.0)
    host.muscles.position[0] = turned
    host.wait(0.01)
    assert host.present(1) == turned
    reboot(host)
    assert host.present(1) == turned % 4096


@pytest.mark.parametrize("mode", [0, 1, 4, 5, 16])
def test_torque_on_keeps_the_turns_but_in_position_mode(mode: int) -> None:
    """e-manual, operating mode note, case 2: of mode 3 alone."""
    host = Host([1], settings={"operating_mode": mode})
    host.write(1, 100, 0, 2)  # no output, so that it stays there
    host.muscles.position[0] = 9000.0
    host.wait(0.01)
    host.torque(1)
    assert host.present(1) == 9000


def test_near_tick_0_a_boot_may_come_back_a_turn_away_by_its_seed() -> None:
    """DynamixelSDK #380, #515; forum 4570. The same seed gives the same boots; away from the seam nothing."""
    runs = []
    for _ in range(2):
        host = Host([1], settings={"operating_mode": 4}, start=4095.0, seam_seed=3)
        seen = []
        for _ in range(30):
            reboot(host)
            seen.append(host.present(1))
        runs.append(seen)
    assert runs[0] == runs[1]
    assert set(runs[0]) == {-1, 4095}
    far = Host([1], settings={"operating_mode": 4}, start=2000.0, seam_seed=3)
    mode_3 = Host([1], start=4095.0, seam_seed=3)
    for host, expected in ((far, 2000), (mode_3, 4095)):
        for _ in range(10):
            reboot(host)
            assert host.present(1) == expected


def test_a_p_series_has_its_own_turn() -> None:
    """e-manual, PH54-100-S500: 1,003,846 counts a turn."""
    host = Host([1], model="PH54-100-S500", settings={"operating_mode": 4}, start=0.0)
    host.muscles.position[0] = 1_003_846 * 2 + 5
    host.wait(0.01)
    assert host.read(1, 580, 4) == 1_003_846 * 2 + 5
    reboot(host)
    assert host.read(1, 580, 4) == 5
    host.muscles.position[0] = -400_000
    reboot(host)
    assert host.read(1, 580, 4) == -400_000, "its one turn lies around 0 (e-manual, -501,923..501,923)"


def test_a_boot_ends_a_trip_of_the_watchdog() -> None:
    """Register 98 is RAM (e-manual, "Bus Watchdog"): 0 after a boot, goals are open again."""
    host = Host([1])
    host.write(1, 98, 5, 1)
    host.torque(1)
    host.wait(0.2)
    assert (host.read(1, 98, 1), host.goal(1, 2100)) == (-1, 4)
    reboot(host)
    host.torque(1)
    assert (host.read(1, 98, 1), host.goal(1, 2100)) == (0, 0)
    host.wait(1.0)
    assert host.present(1) == pytest.approx(2100, abs=1)


# ---------------------------------------------------------------------- startup configuration


@pytest.mark.parametrize(("startup", "torque"), [(0, 0), (1, 1), (2, 0), (3, 1)])
def test_bit_0_boots_with_torque_on_and_the_goal_where_it_is(startup: int, torque: int) -> None:
    host = Host([1])
    host.write(1, 60, startup, 1)
    host.muscles.position[0] = 2500.0
    reboot(host)
    assert (host.read(1, 64, 1), host.read(1, 116, 4)) == (torque, 2500)
    host.wait(1.0)
    assert host.present(1) == 2500, "nothing moves by a boot"


def test_bit_1_boots_with_the_settings_of_the_backup() -> None:
    """e-manual, "Startup Configuration": RAM Restore. Goals, torque and watchdog are no settings."""
    for startup, gain, mapped in ((0, 800, 224), (2, 1234, 132)):
        host = Host([1], settings={"startup_configuration": startup})
        for address, value, size in ((84, 1234, 2), (112, 77, 4), (168, 132, 2), (116, 3000, 4), (98, 9, 1)):
            assert host.write(1, address, value, size) == 0
        (answer,) = host.ask(packet.instruction(1, Instruction.BACKUP, STORE))
        assert answer.error == 0
        host.write(1, 84, 55, 2)
        reboot(host)
        assert [host.read(1, *at) for at in ((84, 2), (168, 2), (224, 1))] == [gain, mapped, 0]
        assert [host.read(1, *at) for at in ((116, 4), (98, 1), (64, 1))] == [2048, 0, 0]


def test_bit_1_without_a_backup_gives_defaults() -> None:
    host = Host([1], settings={"startup_configuration": 2})
    host.write(1, 84, 1234, 2)
    reboot(host)
    assert (host.read(1, 84, 2), host.read(1, 147, 1)) == (800, 0)
