"""A bus and its life: when it is tried again, what ends with it, and one transaction of a script a tick."""

from collections.abc import Callable
from itertools import pairwise
from math import inf
from typing import Any

import pytest

from tests.support.two_bus_rig import JOINTS, PERIOD, TwoBuses
from twind.loop.bus.bus_port import REOPEN_FIRST, REOPEN_MOST, BusPort, PortState
from twind_drivers.bus import (
    BusError,
    PingRequest,
    PortError,
    ReadRequest,
    RebootRequest,
    RequestReply,
    Script,
    WireRangeError,
    WriteRequest,
)

TORQUE = 64  # register, 1 byte


@pytest.fixture
def world() -> TwoBuses:
    world = TwoBuses()
    world.connect()
    return world


@pytest.fixture
def port(world: TwoBuses) -> BusPort:
    """The left bus, servos 1 to 3, open for writing."""
    return world.ports[0]


def pings(*ids: int) -> Script[list[int]]:
    """Return the ids that answer."""
    found = []
    for id in ids:
        reply = yield PingRequest(id)
        found += list(reply.data)
    return found


# ------------------------------------------------------------------------------------- open and lost


def gaps(tries: list[tuple[str, float]], name: str) -> list[float]:
    times = [time for bus, time in tries if bus == name]
    return [round(late - early, 6) for early, late in pairwise(times)]


def test_a_port_that_is_not_there_is_tried_again_ever_slower_up_to_half_a_second() -> None:
    world = TwoBuses()
    world.virtual["left"].faults.unplug()
    world.tick(count=300)
    waits = gaps(world.tries, "left")
    steady = [REOPEN_MOST] * (len(waits) - 3)
    assert waits == pytest.approx([REOPEN_FIRST, 0.2, 0.4, *steady], abs=1.1 * PERIOD)
    assert len(waits) > 5
    assert world.ports[0].trouble == "virtual:left: no such port"
    assert [name for name, _ in world.tries].count("right") == 1


def test_after_a_success_the_tries_begin_fast_again(world: TwoBuses) -> None:
    world.tries.clear()
    world.virtual["left"].faults.unplug()
    lost_at = world.clock.now()
    world.tick(count=80)
    assert world.tries[0][1] == pytest.approx(lost_at + REOPEN_FIRST, abs=1.5 * PERIOD)
    assert gaps(world.tries, "left")[0] == pytest.approx(REOPEN_FIRST, abs=1.1 * PERIOD)
    world.virtual["left"].faults.replug()
    world.tick(count=60)
    assert world.ports[0].link is PortState.IDENTIFYING
    assert world.ports[0].trouble == ""


def test_without_a_port_nothing_is_ever_opened() -> None:
    def opener(name: str) -> Any:
        raise AssertionError(f"{name} was opened")

    port = BusPort("main", None, opener, opener)
    assert not any(port.open(now) for now in (0.0, 1.0, 1e6))


def test_a_newly_opened_port_identifies_every_device(world: TwoBuses, port: BusPort) -> None:
    world.virtual["left"].faults.silence(2)
    port.identify()
    assert port.link is PortState.IDENTIFYING
    task = port.identification
    assert task is not None
    world.tick(count=40)
    assert task.done
    assert [device.id for device in task.result or ()] == [1, 3]


def test_being_asked_anew_ends_the_identification_that_is_under_way(world: TwoBuses, port: BusPort) -> None:
    port.identify()
    first = port.identification
    world.tick(count=1)
    port.identify()
    assert first is not None
    assert port.identification is not first
    assert "identified anew" in str(first.error)
    world.tick(count=40)
    assert port.identification is not None
    assert [device.id for device in port.identification.result or ()] == [1, 2, 3]


def test_with_the_port_every_task_ends_and_what_was_known_of_it_goes(world: TwoBuses, port: BusPort) -> None:
    tasks = [port.run(pings(1, 2, 3)) for _ in range(3)]
    reader = port.reader
    assert reader is not None
    world.virtual["left"].faults.unplug()
    world.tick()
    assert port.link is PortState.CLOSED
    assert (port.reader, port.writer, port.devices, port.identification) == (None, None, (), None)
    assert [task.done for task in tasks] == [True] * 3
    assert all(isinstance(task.error, PortError) and task.error.lost for task in tasks)
    with pytest.raises(PortError, match="closed"):  # the descriptor was let go of at once
        reader.transport.drain()


def test_a_bus_that_went_away_gets_no_goals_when_it_is_back(world: TwoBuses, port: BusPort) -> None:
    world.hardware.hold(True)
    assert port.holding
    world.virtual["left"].faults.unplug()
    world.tick(count=3)
    world.virtual["left"].faults.replug()
    world.tick(count=100)
    assert port.writer is not None
    assert (port.holding, world.ports[1].holding) == (False, True)


def test_a_lost_port_counts_as_an_error_and_one_closed_on_purpose_does_not(
    world: TwoBuses, port: BusPort
) -> None:
    before = port.counts.errors
    port.close()
    assert port.reader is None
    assert port.counts.errors == before
    world.tick(count=2)  # the mode still wants it: it opens again at once
    assert port.reader is not None
    world.virtual["left"].faults.unplug()
    world.tick()
    assert port.counts.errors == before + 1


def test_a_closed_port_ends_its_tasks_too(world: TwoBuses, port: BusPort) -> None:
    task = port.run(pings(1))
    port.close()
    assert task.done
    assert "closed" in str(task.error)
    port.close()  # twice is no harm


# ------------------------------------------------------------------------------------- scripts


def test_an_urgent_script_takes_one_transaction_a_tick_and_hands_over_its_result(
    world: TwoBuses, port: BusPort
) -> None:
    world.virtual["left"].faults.silence(2)
    task = port.run(pings(1, 2, 3), urgent=True)
    steps = []
    for _ in range(4):
        steps.append(task.done)
        world.tick()
    assert steps == [False, False, False, True]
    assert (task.result, task.error) == ([1, 3], None)


def test_a_script_that_ends_at_once_is_done_and_never_queued(port: BusPort) -> None:
    task = port.run(pings())
    assert (task.done, task.result) == (True, [])
    assert port.tasks == []


@pytest.mark.parametrize("requests", [0, 1])
@pytest.mark.parametrize(
    "error", [BusError("silent"), KeyError("no such register"), ValueError("out of range")]
)
def test_a_failed_script_keeps_its_error_for_its_waiter(
    world: TwoBuses, port: BusPort, error: Exception, requests: int
) -> None:
    def script() -> Script[None]:
        for _ in range(requests):
            yield PingRequest(1)
        raise error

    task = port.run(script())
    world.tick(count=2)
    assert task.done
    assert task.error is error
    assert port.tasks == []


def test_an_unexpected_exception_of_a_script_is_not_suppressed(port: BusPort) -> None:
    def script() -> Script[None]:
        raise ZeroDivisionError
        yield PingRequest(1)

    with pytest.raises(ZeroDivisionError):
        port.run(script())


def test_scripts_run_in_the_order_they_came_but_one_that_must_be_first(
    world: TwoBuses, port: BusPort
) -> None:
    early = port.run(pings(1, 2))
    late = port.run(pings(1))
    urgent = port.run(pings(3), urgent=True)
    order = []
    for _ in range(10):
        world.tick()
        order += [name for name, task in zip("elu", (early, late, urgent), strict=True) if task.done]
    assert "".join(dict.fromkeys(order)) == "uel"


def test_dropping_ends_everything_but_identification(world: TwoBuses, port: BusPort) -> None:
    port.identify()
    task = port.run(pings(1, 2, 3))
    world.tick()
    port.drop("an e-stop came")
    assert "left: an e-stop came" in str(task.error)
    assert port.identification is not None
    assert not port.identification.done
    world.tick(count=40)
    assert port.identification.done
    assert port.identification.error is None


def test_a_dropped_script_does_not_get_the_answer_it_asked_for(world: TwoBuses, port: BusPort) -> None:
    heard: list[RequestReply] = []

    def script() -> Script[None]:
        while True:
            heard.append((yield PingRequest(1)))

    task = port.run(script())
    assert port.begin_rare(world.clock.now(), inf)
    port.drop("too late")
    port.end_rare(world.clock.now())
    assert heard == []
    assert task.done


def test_a_script_that_fails_inside_fails_the_tick_once_and_is_no_success_afterwards(
    world: TwoBuses, port: BusPort
) -> None:
    def script() -> Script[None]:
        yield PingRequest(1)
        raise IndexError("a bug")

    task = port.run(script())
    with pytest.raises(IndexError):
        world.tick(count=3)
    assert task.done
    assert "a bug" in str(task.error)
    world.tick(count=3)
    assert port.tasks == []


# ------------------------------------------------------------------------------------- read-only


@pytest.mark.parametrize("order", [WriteRequest({1: b"\1"}, TORQUE), RebootRequest(1)])
def test_a_read_only_port_refuses_every_write_and_the_servos_receive_nothing(order: Any) -> None:
    world = TwoBuses(live=False)
    world.connect()
    port = world.ports[0]

    def script() -> Script[None]:
        yield order

    task = port.run(script())
    world.tick(count=3)
    assert task.done
    assert f"opened read-only, {type(order).__name__} refused" in str(task.error)
    assert world.virtual["left"].servos["torque_enable"].tolist() == [0, 0, 0]
    assert port.tasks == []


def test_an_order_that_fails_the_last_check_ends_its_script_and_the_reading_goes_on(
    world: TwoBuses, port: BusPort
) -> None:
    def script() -> Script[None]:
        yield WriteRequest({1: (9999).to_bytes(4, "little")}, 116)  # a goal outside the clamp

    before = world.goals()
    task = port.run(script())
    state = world.tick(count=2)
    assert isinstance(task.error, WireRangeError)
    assert state.heard.all()
    assert world.goals() == before


# ------------------------------------------------------------------------------------- time


def test_a_torque_change_is_sent_without_room_and_no_script_waits_for_ever(
    world: TwoBuses, port: BusPort
) -> None:
    now = world.clock.now()
    assert not port.begin_rare(now, now + 0.0001)  # upkeep
    port.run(pings(1))
    tries = [port.begin_rare(now, now + 0.0001) for _ in range(12)]
    assert True in tries
    assert not tries[0]


def test_an_urgent_script_begins_at_once_however_late_the_tick_is(world: TwoBuses, port: BusPort) -> None:
    now = world.clock.now()
    port.run(pings(1), urgent=True)
    assert port.begin_rare(now, now - 1.0)


def identify(port: BusPort) -> None:
    port.identify()


def run_scripts(port: BusPort) -> None:
    port.run(pings(1))
    port.run(pings(2))


@pytest.mark.parametrize("load", [lambda _: None, identify, run_scripts], ids=["none", "identity", "scripts"])
def test_no_load_starves_the_slow_registers(
    world: TwoBuses, port: BusPort, load: Callable[[BusPort], None]
) -> None:
    assert port.reader is not None
    before = port.reader.registers.status_time.copy()
    for _ in range(20):
        load(port)
        world.tick()
    assert (port.reader.registers.status_time > before).all()
    assert port.full is (load is run_scripts)
    assert (port.link is PortState.IDENTIFYING) is (load is identify)


def test_every_exchange_is_counted_and_those_with_a_silent_servo_as_errors(
    world: TwoBuses, port: BusPort
) -> None:
    before = (port.counts.exchanges, port.counts.errors)
    world.tick(count=5)
    assert (port.counts.exchanges, port.counts.errors) == (before[0] + 5, before[1])
    world.virtual["left"].faults.silence(2)
    world.tick(count=3)
    assert (port.counts.exchanges, port.counts.errors) == (before[0] + 8, before[1] + 3)
    world.virtual["left"].faults.silence(2, on=False)
    world.tick(count=20)
    discarded = port.counts.discarded
    world.virtual["left"].faults.foreign(2)
    world.tick(count=2)
    assert port.counts.discarded > discarded
    assert 0.0 < port.counts.busy < PERIOD


def test_bytes_astray_in_the_answer_to_a_script_are_counted_too(world: TwoBuses, port: BusPort) -> None:
    before = port.strays
    task = port.run(pings(1), urgent=True)
    world.virtual["left"].faults.corrupt(1, id=1)
    port.begin_rare(world.clock.now(), inf)
    assert port.reader is not None
    world.clock.sleep_until(port.reader.deadline)
    port.reader.feed(world.clock.now())
    port.end_rare(world.clock.now())
    assert (task.result, port.strays > before) == ([], True)


def test_replies_that_other_programs_delay_count_until_the_tick_ends(world: TwoBuses, port: BusPort) -> None:
    """Slow registers: by 3 ms, in every tick; the cyclic reading: by 7 ms, in one tick."""
    left = world.virtual["left"].faults
    left.delay(0.003)
    world.tick(count=20)
    assert port.reader is not None
    assert (world.clock.now() - port.reader.registers.status_time < 0.1).all()
    left.delay(0.007)
    world.tick()
    left.delay(0.0)
    world.tick(count=2)
    assert (port.counts.errors, port.counts.discarded) == (0, 0)


def test_a_bus_that_delays_every_reply_starves_no_other(world: TwoBuses) -> None:
    world.virtual["left"].faults.delay(0.0065)
    slow, begun = world.hardware.slow, world.clock.now()
    world.tick(count=50)
    right = JOINTS.buses[1].joints
    assert (slow.status_time[right] > begun + 0.4).all()


def exchange_span(world: TwoBuses) -> float:
    """Seconds that the exchange of the next tick takes."""
    begun = world.clock.now()
    world.hardware.exchange(None, begun)
    span = world.clock.now() - begun
    world.clock.sleep_until(begun + PERIOD)
    return span


@pytest.mark.parametrize("silent", [(2,), (1, 2, 3)])
def test_silent_servos_take_the_time_of_a_late_reply_once(world: TwoBuses, silent: tuple[int, ...]) -> None:
    for id in silent:
        world.virtual["left"].faults.silence(id)
    spans = [exchange_span(world) for _ in range(20)]
    assert spans[0] > 0.8 * PERIOD
    assert max(spans[1:]) < 0.75 * PERIOD


@pytest.mark.parametrize("reason", ["a silent servo", "an urgent script"])
def test_what_one_bus_needs_time_for_no_late_reply_of_another_takes(world: TwoBuses, reason: str) -> None:
    if reason == "a silent servo":
        world.virtual["right"].faults.silence(5)
        world.tick()
    else:
        world.ports[1].run(pings(4), urgent=True)
    world.virtual["left"].faults.delay(0.007)
    assert exchange_span(world) < 0.75 * PERIOD


def test_a_parked_servo_takes_no_time_of_late_replies(world: TwoBuses, port: BusPort) -> None:
    world.virtual["left"].faults.silence(2)
    world.tick(count=200)
    world.virtual["left"].faults.delay(0.007)
    strays = port.counts.discarded
    world.tick()
    world.virtual["left"].faults.delay(0.0)
    world.tick()
    assert port.counts.discarded == strays


def test_beside_a_servo_that_does_not_reply_again_time_for_a_rare_transaction_is_kept_free(
    world: TwoBuses, port: BusPort
) -> None:
    world.virtual["left"].faults.silence(2)
    world.tick()
    task = port.run(pings(1, 3))
    world.tick(count=4)
    assert task.result == [1, 3]


def test_a_read_of_an_id_of_another_bus_gets_an_empty_result(world: TwoBuses, port: BusPort) -> None:
    def script() -> Script[dict[int, bytes]]:
        reply = yield ReadRequest((5,), TORQUE, 1)
        return dict(reply.data)

    task = port.run(script())
    world.tick(count=2)
    assert task.result == {}
