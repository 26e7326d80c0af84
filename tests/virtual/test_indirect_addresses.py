"""Indirect registers: e-manual, "Indirect Address, Indirect Data"; layouts by the vendor's tables."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import table
from twind_drivers.virtual.indirect_addresses import fields, rows


def point(host: Host, id: int, targets: list[int], *, address: int = 168) -> None:
    """Indirect address 1 and on at `targets`, one by one."""
    for place, target in enumerate(targets):
        assert host.write(id, address + 2 * place, target, 2) == 0


@pytest.mark.parametrize(
    ("number", "firmware", "found"),
    [
        (1020, 47, [(168, 224, 28), (578, 634, 28)]),  # XM430-W350
        (1120, 47, [(168, 224, 28), (578, 634, 28)]),  # XM540-W270
        (321, 47, [(168, 224, 28), (578, 634, 28)]),  # MX-106(2.0)
        (1200, 51, [(168, 224, 28)]),  # XL330-M288
        (1200, 52, [(168, 208, 20)]),
        (2010, 12, [(168, 634, 128)]),  # PH54-100-S500
    ],
)
def test_each_model_has_its_rows(number: int, firmware: int, found: list[tuple[int, int, int]]) -> None:
    registers = table(number, firmware)
    assert [tuple(row) for row in rows(registers)] == found
    assert len(list(fields(registers))) == 2 * sum(row[2] for row in found)


@pytest.mark.parametrize(
    ("model", "firmware", "data"), [("XM430-W350", 47, 224), ("XL330-M288", 47, 224), ("XL330-M288", 52, 208)]
)
def test_new_each_entry_points_at_its_own_data_which_is_plain_memory(
    model: str, firmware: int, data: int
) -> None:
    host = Host([1], model=model, firmware=firmware)
    assert [host.read(1, 168 + 2 * place, 2) for place in range(20)] == [data + place for place in range(20)]
    assert host.write(1, data + 3, 0x5A, 1) == 0
    assert (host.read(1, data + 3, 1), host.read(1, data + 2, 1)) == (0x5A, 0)


def test_the_vendors_examples_led_and_goal_position() -> None:
    """e-manual, "Indirect Address", examples 1 and 2."""
    host = Host([1])
    point(host, 1, [65, 116, 117, 118, 119])
    assert host.write(1, 224, 1, 1) == 0
    assert host.read(1, 65, 1) == 1
    assert host.write(1, 225, 1024, 4) == 0
    assert host.read(1, 116, 4) == 1024
    host.torque(1)
    host.wait(3.0)
    assert host.read(1, 225, 4) == 1024
    assert host.present(1) == pytest.approx(1024, abs=1)


def test_the_rules_of_the_target_hold() -> None:
    """e-manual, "Indirect Address": the data inherits size, range and access of its target."""
    host = Host([1])
    point(host, 1, [132, 133, 134, 135, 64, 116, 117, 118, 119, 116, 117])
    assert host.write(1, 224, 5, 4) == 7, "present position is read-only"
    assert host.write(1, 228, 2, 1) == 4, "torque enable is 0 or 1"
    assert host.write(1, 229, 4096, 4) == 6, "beyond the max position limit"
    assert host.write(1, 229, 100, 2) == 5, "a part of a register"
    assert host.write(1, 233, 100, 2) == 5, "that is all of it that is mapped"
    assert host.write(1, 230, 100, 1) == 7, "no register begins there"
    assert host.read(1, 116, 4) == 2048
    assert host.write(1, 228, 3000 << 8 | 1, 5) == 0, "torque and goal in one write"
    assert (host.read(1, 64, 1), host.read(1, 116, 4)) == (1, 3000)


@pytest.mark.parametrize(
    ("model", "inside", "outside"),
    [("XM430-W350", (64, 661), (63, 662)), ("XL330-M288", (64, 227), (63, 252))],
)
def test_only_ram_can_be_pointed_at(model: str, inside: tuple[int, int], outside: tuple[int, int]) -> None:
    """e-manual, "Indirect Address": 64..661, X330 64..227."""
    host = Host([1], model=model)
    assert [host.write(1, 168, target, 2) for target in inside] == [0, 0]
    assert [host.write(1, 168, target, 2) for target in outside] == [4, 4]


def test_on_the_p_series_an_indirect_address_is_eeprom() -> None:
    """e-manual, P series: 168 lies below torque enable (512), so it is locked and survives a reboot."""
    host = Host([1], model="PH54-100-S500")
    point(host, 1, [580, 581, 582, 583])
    host.ask(packet.reboot(1))
    host.wait(0.2)
    assert host.read(1, 634, 4) == host.read(1, 580, 4) == 2048
    host.write(1, 512, 1, 1)
    assert host.write(1, 168, 512, 2) == 7


def test_a_reboot_clears_the_indirect_mapping_of_an_x_servo() -> None:
    host = Host([1])
    point(host, 1, [132, 133, 134, 135])
    assert host.read(1, 224, 4) == 2048
    host.ask(packet.reboot(1))
    host.wait(0.2)
    assert (host.read(1, 168, 2), host.read(1, 224, 4)) == (224, 0)


@examples(40)
@given(
    st.lists(st.integers(64, 146), min_size=1, max_size=28),
    st.integers(0, 20),
    st.booleans(),
    st.sampled_from([168, 578]),
)
def test_any_mapping_reads_like_its_targets_short_way_and_long_way(
    targets: list[int], before: int, fast: bool, address: int
) -> None:
    """Group reads of a span that begins before the indirect data, remembered and not."""
    host = Host([1, 2, 3])
    point(host, 2, targets, address=address)
    host.wait(0.01)
    first = (224 if address == 168 else 634) - before
    size = before + len(targets)
    host.raw(packet.read(1, 132, 4))
    host.keep_readings()
    there = host.ask(packet.read(2, 64, 83))[0].data  # gaps read as 0
    plain = bytes(there[target - 64] for target in targets)
    ask = packet.fast_sync_read if fast else packet.sync_read
    seen = {host.raw(ask([1, 2, 3], first, size)) for _ in range(3)}
    assert len(seen) == 1
    (answer,) = host.ask(packet.read(2, first, size))
    gaps = not before and all(not host.servos.memory.readable(1, target, 1) for target in targets)
    assert answer.error == (7 if gaps else 0)
    if not gaps:
        assert answer.data[before:] == plain
        assert (ask([1, 2, 3], first, size) in host.bus.group_reads) or not fast
        assert plain in packet.unstuff(seen.pop())


def test_a_cached_read_follows_a_changed_mapping() -> None:
    host = Host([1, 2])
    request = packet.sync_read([1, 2], 224, 2)
    for target in (132, 144, 120):
        for id in (1, 2):
            point(host, id, [target, target + 1])
        for _ in range(2):
            for answer in host.ask(request):
                assert answer.data == host.ask(packet.read(answer.id, target, 2))[0].data


def test_a_moving_target_is_never_shown_from_memory() -> None:
    """A span of settings needs no refresh; one that maps the present position does."""
    host = Host([1])
    point(host, 1, [132, 133, 134, 135])
    request = packet.fast_sync_read([1], 224, 4)
    host.raw(request)
    host.torque(1)
    host.goal(1, 3000)
    seen = []
    for _ in range(4):
        host.raw(request)
        host.wait(0.05)
        seen.append(int.from_bytes(host.raw(request)[10:14], "little"))
    assert seen == sorted(set(seen))


def test_goals_through_indirect_data_by_sync_write() -> None:
    host = Host([1, 2])
    for id in (1, 2):
        point(host, id, [116, 117, 118, 119])
    for goal in (1000, 3000):
        host.raw(packet.sync_write(224, {id: (goal + id).to_bytes(4, "little") for id in (1, 2)}))
        assert host.servos["goal_position"].tolist() == [goal + 1, goal + 2]
