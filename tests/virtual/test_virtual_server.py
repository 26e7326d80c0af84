import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.virtual_serial_host import Host
from twind.exceptions import InvalidInput
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.virtual_server import PAGE, STALL, ServoClock, VirtualBusServer
from twind_drivers.clock import FakeClock


def test_the_servos_do_not_live_through_a_stall() -> None:
    real = FakeClock(100.0)
    clock = ServoClock(real)
    for _ in range(50):
        real.sleep_until(real.now() + 0.002)
        clock.now()
    assert clock.now() == pytest.approx(100.1)
    real.sleep_until(real.now() + 5.0)
    assert clock.now() == pytest.approx(100.1 + STALL)
    assert clock.skipped_time == pytest.approx(5.0 - STALL)


def server(*names: str) -> tuple[VirtualBusServer, dict[str, Host], list[str]]:
    hosts = {name: Host([1, 2]) for name in names}
    ports = {name: VirtualPtyPort(name, None) for name in names}
    said: list[str] = []
    buses = {name: host.bus for name, host in hosts.items()}
    return (
        VirtualBusServer(
            buses, ports, ServoClock(FakeClock()), lambda name, path: said.append(f"{name} {path}")
        ),
        hosts,
        said,
    )


def test_orders_reach_the_bus_they_name() -> None:
    made, hosts, _ = server("left", "right")
    assert made.execute_fault_command({"fault": "silence", "bus": "right", "id": 2})["ok"]
    assert hosts["left"].servos.listening.tolist() == [True, True]
    assert hosts["right"].servos.listening.tolist() == [True, False]
    for wrong in ({"fault": "drop", "count": 1}, {"fault": "drop", "count": 1, "bus": "up"}):
        with pytest.raises(InvalidInput, match="there are left, right"):
            made.execute_fault_command(wrong)
    with pytest.raises(InvalidInput, match="there are state, history"):
        made.execute_fault_command({"query": "weather"})


def test_with_a_single_bus_its_name_is_optional_and_replug_reports_the_new_path() -> None:
    made, hosts, said = server("main")
    made.execute_fault_command({"fault": "unplug"})
    assert not hosts["main"].bus.is_plugged
    answer = made.execute_fault_command({"fault": "replug"})
    assert hosts["main"].bus.is_plugged
    assert said == [f"main {answer['path']}"]


def test_replugged_under_another_name_the_link_follows(tmp_path: Path) -> None:
    port = VirtualPtyPort("main", tmp_path / "main")
    before = port.path
    port.unplug()
    port.plug(renamed=True)
    assert port.path != before
    assert os.readlink(tmp_path / "main") == port.path
    port.close()


def test_a_link_served_by_another_process_is_refused_even_while_unplugged(tmp_path: Path) -> None:
    link = tmp_path / "main"
    first = VirtualPtyPort("main", link)
    with pytest.raises(OSError, match=f"{link}: another twind-virtual serves it; end it"):
        VirtualPtyPort("main", link)
    assert os.readlink(link) == first.path
    first.unplug()
    with pytest.raises(OSError, match="another twind-virtual"):
        VirtualPtyPort("main", link)
    first.close()
    VirtualPtyPort("main", link).close()


def test_a_stale_link_is_replaced_and_a_foreign_one_is_left(tmp_path: Path) -> None:
    link = tmp_path / "main"
    link.symlink_to("/dev/pts/none")
    port = VirtualPtyPort("main", link)
    assert os.readlink(link) == port.path
    link.unlink()
    link.symlink_to("/dev/null")
    port.close()
    assert os.readlink(link) == "/dev/null"


def test_a_recorded_history_is_returned_page_by_page() -> None:
    made, hosts, _ = server("main")
    with pytest.raises(InvalidInput, match='"record"'):
        made.execute_fault_command({"query": "history"})
    made.execute_fault_command({"fault": "record", "count": 2000})
    history = hosts["main"].servos.history
    assert history is not None
    for at in range(PAGE + 7):
        history.note(at * 0.001, np.array([at, -at]))
    first = made.execute_fault_command({"query": "history"})
    assert (first["ids"], first["more"], len(first["time"])) == ([1, 2], True, PAGE)
    rest = made.execute_fault_command({"query": "history", "since": first["time"][-1]})
    assert (rest["more"], rest["position"][-1]) == (False, [PAGE + 6, -PAGE - 6])
    assert len(rest["time"]) == 7
    with pytest.raises(InvalidInput, match="a time in s"):
        made.execute_fault_command({"query": "history", "since": "now"})
    json.dumps(first)


def test_the_state_query_returns_the_true_state_of_every_servo() -> None:
    made, hosts, _ = server("main")
    host = hosts["main"]
    host.torque(1)
    host.muscles.position[1] += 0.25
    state = made.execute_fault_command({"query": "state"})
    one, two = state["buses"]["main"]["servos"]
    assert (one["id"], one["torque"], one["goal"], one["tripped_at"]) == (1, True, 2048, None)
    assert (two["torque"], two["position"]) == (False, 2048.25)
    assert np.isfinite(one["heard_ago"])


def test_the_clock_of_a_servo_goes_on_through_a_stall_and_its_watchdog_does_not() -> None:
    real = FakeClock()
    host = Host([1, 2])
    clock = ServoClock(real)
    made = VirtualBusServer(
        {"main": host.bus}, {"main": VirtualPtyPort("main", None)}, clock, lambda name, path: None
    )

    def shown() -> list[int]:
        host.servos.settle(clock.now())
        made.count_skipped_time()
        host.servos.invalidate_cache()  # the registers are shown anew
        host.servos.settle(clock.now())
        return [int(each) for each in host.servos.memory.column("realtime_tick", 2).get()]

    before = shown()
    lived = clock.now()
    real.sleep_until(real.now() + 5.0)
    assert clock.now() - lived == pytest.approx(STALL)
    assert shown() == [each + 5000 for each in before]
    assert shown() == [each + 5000 for each in before]  # counted once
