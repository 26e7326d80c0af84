"""The doctor reads the kernel's CAN interfaces: `ip -details -json` in every state, and what is here."""

import json
from pathlib import Path

import pytest

from tests.support.doctor_rig import found, host, mended, plant
from twind.doctor import runner
from twind.doctor.can_links import CanNetworkInterface, judge_link, read_link, with_details
from twind.doctor.check import Severity, severity_of
from twind.doctor.host_inspector import HostInspector
from twind_drivers.ports.can_interface_control import CAN_TYPE

LEGS = ("--robot", "h24-mixed", "--port", "l_leg=can:socketcan:can0")


def link_details(
    state: str = "ERROR-ACTIVE", bitrate: int = 1_000_000, restart: int = 100, up: bool = True
) -> str:
    """Output of `ip -details -json link show dev can0`, as iproute2's iplink_can.c writes it."""
    about = {
        "state": state,
        "restart_ms": restart,
        "berr_counter": {"tx": 128, "rx": 3},
        "bittiming": {"bitrate": bitrate, "sample_point": "0.750", "tq": 50},
        "clock": 80_000_000,
    }
    flags = ["NOARP", "UP", "LOWER_UP", "ECHO"] if up else ["NOARP", "ECHO"]
    entry = {"ifindex": 3, "ifname": "can0", "flags": flags, "link_type": "can", "txqlen": 10}
    return json.dumps([entry | {"linkinfo": {"info_kind": "can", "info_data": about}}])


def link(text: str, *, up: bool = True, queue: int = 10) -> CanNetworkInterface:
    return with_details(CanNetworkInterface("can0", CAN_TYPE, up, queue), text)


def codes(one: CanNetworkInterface) -> list[str]:
    return [each.code for each in judge_link(HostInspector(), one, 1_000_000)]


def test_a_well_interface_gives_no_alarm() -> None:
    assert codes(link(link_details())) == []


@pytest.mark.parametrize("state", ["BUS-OFF", "ERROR-PASSIVE"])
def test_controller_off_the_bus_is_reported_with_its_counters(state: str) -> None:
    (finding,) = judge_link(HostInspector(), link(link_details(state)), 1_000_000)
    assert (finding.code, finding.measured) == ("CAN_LINK_STATE", f"{state}, errors tx 128, rx 3")
    assert finding.command.splitlines()[1] == "sudo ip link set can0 down"


def test_a_controller_that_counts_some_errors_still_works_and_is_not_taken_down() -> None:
    (finding,) = judge_link(HostInspector(), link(link_details("ERROR-WARNING")), 1_000_000)
    assert (finding.code, finding.measured) == ("BUS_NOISE", "ERROR-WARNING, errors tx 128, rx 3")
    assert finding.command == ""
    assert severity_of(finding, runner.table()) is Severity.WARNING


@pytest.mark.parametrize(
    "details", [link_details("BUS-OFF"), link_details(bitrate=500_000), link_details(restart=0)]
)
def test_link_that_is_up_is_taken_down_only_after_disarming(details: str) -> None:
    (finding,) = judge_link(HostInspector(), link(details), 1_000_000)
    first, second, third = finding.command.splitlines()
    assert (first, second) == ("twindctl disarm", "sudo ip link set can0 down")
    assert third.startswith("sudo ip link set can0 up ")
    row = runner.table()[finding.code].remedy
    assert row.index("`twindctl disarm`") < row.index("`sudo ip link set can0 down`")
    (down, *_) = judge_link(HostInspector(), link(details, up=False), 1_000_000)
    assert "disarm" not in down.command, "it is down already"


def test_wrong_bit_rate_is_reported_with_both_rates() -> None:
    (finding,) = judge_link(HostInspector(), link(link_details(bitrate=500_000)), 1_000_000)
    assert (finding.code, finding.measured, finding.expected) == (
        "CAN_LINK_STATE",
        "500000 bit/s",
        "1000000 bit/s",
    )
    assert "up type can bitrate 1000000 restart-ms 100" in finding.command


def test_interface_that_is_down_is_one_finding() -> None:
    assert codes(link(link_details("STOPPED", up=False), up=False)) == ["CAN_LINK_DOWN"]


def test_controller_without_restart_time_is_reported() -> None:
    (finding,) = judge_link(HostInspector(), link(link_details(restart=0)), 1_000_000)
    assert (finding.code, finding.measured) == ("CAN_LINK_STATE", "restart-ms 0")
    assert severity_of(finding, runner.table()) is Severity.WARNING


@pytest.mark.parametrize(("queue", "wrong"), [(10, False), (100, False), (101, True), (1000, True)])
def test_a_queue_is_long_above_100_frames(queue: int, wrong: bool) -> None:
    assert codes(link(link_details(), queue=queue)) == (["CAN_LINK_STATE"] if wrong else [])


def test_a_virtual_can_has_no_controller_to_complain_of() -> None:
    bare = json.dumps([{"ifname": "vcan0", "linkinfo": {"info_kind": "vcan"}}])
    assert codes(link(bare)) == [] and link(bare).restart_ms is None


@pytest.mark.parametrize("text", ["", "[]", "{}", "[1]", "[{}, {}]", '[{"linkinfo": null}]', "no json"])
def test_output_without_details_keeps_the_values_of_the_kernel(text: str) -> None:
    assert link(text) == CanNetworkInterface("can0", CAN_TYPE, True, 10)


def test_interface_of_this_machine_is_read() -> None:
    """Every Linux has `lo`: a loopback of type 772 (ARPHRD_LOOPBACK), up, and no CAN."""
    if not Path("/sys/class/net/lo").exists():
        pytest.skip("no /sys/class/net/lo here")
    one = read_link(HostInspector(), "lo")
    assert one is not None
    assert (one.kind, one.up) == (772, True)
    assert one.queue == int(Path("/sys/class/net/lo/tx_queue_len").read_text())
    assert (one.bitrate, one.state, one.restart_ms) == (None, None, None)
    assert read_link(HostInspector(), "nosuch9") is None


def test_an_interface_that_is_not_there_is_found_with_the_command_that_makes_it() -> None:
    if Path("/sys/class/net/can0").exists():
        pytest.skip("this machine has a can0")
    (finding,) = found(*LEGS, code="CAN_LINK_DOWN")
    assert finding.thing == "can0" and "no such interface; there are:" in finding.measured
    assert finding.command == "sudo ip link set can0 up type can bitrate 1000000 restart-ms 100"


def test_an_interface_of_another_kind_is_no_can_interface() -> None:
    (finding,) = found("--robot", "h24-mixed", "--port", "l_leg=can:socketcan:lo", code="CAN_LINK_DOWN")
    assert finding.thing == "lo" and "is no CAN interface" in finding.measured


def test_a_long_queue_in_sys_is_found_and_shortened(tmp_path: Path) -> None:
    folder = tmp_path / "class/net/can0"
    plant(folder / "type", f"{CAN_TYPE}\n")
    plant(folder / "flags", "0x40081\n")
    queue = plant(folder / "tx_queue_len", "1000\n")
    on = host(sys=tmp_path)
    (finding,) = found(*LEGS, code="CAN_LINK_STATE", on=on)
    assert (
        finding.measured == "a queue of 1000 frames"
        and finding.command == "sudo ip link set can0 txqueuelen 48"
    )
    (tried,) = mended(*LEGS, code="CAN_LINK_STATE", on=on)
    assert (tried.error, tried.there) == ("", False) and queue.read_text() == "48\n"
    plant(folder / "flags", "0x40080\n")
    assert [each.thing for each in found(*LEGS, code="CAN_LINK_DOWN", on=on)] == ["can0"]
