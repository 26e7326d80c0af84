"""Claims that every driver must hold (drivers/README.md, "What must hold"), as tests over a `DriverRig`.

A new driver adds its rig to `RIGS` in `test_driver_contract.py`. A claim is made of what the devices really
do and of what really went out, never of the driver's word alone.
"""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.driver_rig import DriverRig, both
from twind.exceptions import InvalidInput
from twind_drivers.bus import (
    BusError,
    IdentifiedDevice,
    NoReply,
    PortError,
    ReadRequest,
    WireRangeError,
    WriteRequest,
)
from twind_drivers.clock import FakeClock

STEP = 60  # counts that a test moves everybody


class DriverContract:
    """`rig` is a fixture of the module that inherits from this; every test gets one that `fresh` made."""

    # ------------------------------------------------------------------------------- the reading

    def test_a_sample_is_arrays_of_the_ids_in_their_order_with_their_types(self, rig: DriverRig) -> None:
        rig.positions()
        sample = rig.tick()
        for name in ("position", "velocity", "effort"):
            assert getattr(sample, name).shape == (rig.m,), name
            assert getattr(sample, name).dtype == np.int64, name
        assert sample.error.dtype == np.uint8
        assert sample.error.shape == (rig.m,)
        assert sample.heard.dtype == sample.asked.dtype == np.bool_
        assert sample.sent <= sample.received <= rig.clock.now()
        assert abs(sample.position - rig.places()).max() <= 2

    def test_each_row_is_of_its_own_id(self, rig: DriverRig) -> None:
        rig.positions()
        for place, id in enumerate(rig.reader.ids):
            rig.faults.silence(id)
            assert not rig.ticks(5)[-1].heard[place]
            rig.faults.silence(id, False)
            rig.ticks(15)
        assert rig.tick().heard.all()

    def test_registers_have_one_row_for_each(self, rig: DriverRig) -> None:
        rig.positions()
        for name in (
            "torque",
            "fault",
            "watchdog",
            "voltage",
            "temperature",
            "tick",
            "status_time",
            "health_time",
        ):
            assert getattr(rig.registers, name).shape == (rig.m,), name

    def test_a_device_without_a_reply_reads_zero_and_the_others_stay_fresh(self, rig: DriverRig) -> None:
        rig.positions()
        rig.faults.silence(rig.reader.ids[1])
        samples = rig.ticks(30)
        for sample in samples:
            assert not sample.heard[1]
            assert sample.position[1] == sample.velocity[1] == sample.effort[1] == sample.error[1] == 0
        for sample in samples[5:]:
            assert np.delete(sample.heard, 1).all()
            assert not sample.asked[1], "it is waited for for ever"

    def test_a_device_without_a_reply_costs_the_others_no_permanent_timeout(self, rig: DriverRig) -> None:
        rig.positions()
        begin = rig.clock.now()
        rig.read()
        healthy = rig.clock.now() - begin
        rig.faults.silence(rig.reader.ids[0])
        rig.ticks(20)
        begin = rig.clock.now()
        rig.read()
        assert rig.clock.now() - begin < healthy + 0.001, "it waits for who is not there"

    def test_a_reconnected_device_is_fresh_again(self, rig: DriverRig) -> None:
        rig.positions()
        rig.faults.silence(rig.reader.ids[1])
        rig.ticks(10)
        rig.faults.silence(rig.reader.ids[1], False)
        assert rig.ticks(30)[-1].heard.all()

    def test_a_bus_without_replies_gives_no_fresh_reading_and_raises_nothing(self, rig: DriverRig) -> None:
        rig.positions()
        rig.faults.silence()
        for sample in rig.ticks(30):
            assert not sample.heard.any()
            assert not sample.position.any()
        rig.faults.silence(on=False)
        assert rig.ticks(20)[-1].heard.all()

    def test_a_late_answer_is_never_taken_for_a_fresh_one(self, rig: DriverRig) -> None:
        here = rig.arm()
        goal = here
        rig.ticks(5, here)
        rig.faults.delay(0.012, rig.reader.ids[1])
        stale = 0
        for cycle in range(40):
            goal = here + STEP * (cycle % 7)
            sample = rig.read(goal)
            off = abs(sample.position - rig.places())
            stale += int(sample.heard[1] and off[1] > 2 * STEP)
            rig.clock.sleep_until(rig.clock.now() + 0.003 + 0.0007 * (cycle % 5))
            assert np.delete(off, 1)[np.delete(sample.heard, 1)].max(initial=0) <= 3 * STEP
        assert stale == 0

    def test_foreign_traffic_is_dropped_and_counted(self, rig: DriverRig) -> None:
        rig.positions()
        rig.faults.foreign(3)
        samples = rig.ticks(20)
        assert sum(sample.foreign for sample in samples) >= 1
        assert sum(sample.discarded for sample in samples) >= 1
        for sample in samples:
            assert (abs(sample.position - rig.places()) <= 2)[sample.heard].all()

    def test_lost_answers_cost_a_reading_and_never_give_a_wrong_one(self, rig: DriverRig) -> None:
        rig.positions()
        for count in (1, 3, 10):
            rig.faults.drop(count)
            for sample in rig.ticks(15):
                assert (abs(sample.position - rig.places()) <= 2)[sample.heard].all()
        assert rig.ticks(20)[-1].heard.all()

    # ------------------------------------------------------------------------------- the port

    def test_a_port_that_goes_in_the_middle_raises_lost_and_ends_quietly(self, rig: DriverRig) -> None:
        rig.positions()
        rig.reader.request(rig.clock.now())
        rig.faults.unplug()
        with pytest.raises(PortError) as told:
            rig.wait()
        assert told.value.lost
        assert not rig.reader.finish(rig.clock.now()).heard.any()
        with pytest.raises(PortError) as again:
            rig.reader.request(rig.clock.now())
        assert again.value.lost
        rig.reader.transport.close()
        rig.reader.transport.close()

    def test_the_port_can_be_waited_for_and_named(self, rig: DriverRig) -> None:
        transport = rig.reader.transport
        assert transport.name
        assert isinstance(transport.warning, str)
        assert transport.fileno() == -1
        FakeClock().wait([transport], 0.0)

    def test_finish_without_a_request_is_a_bug_of_the_caller_and_answer_never_raises(
        self, rig: DriverRig
    ) -> None:
        reply = rig.reader.answer(rig.clock.now())
        assert not reply.data
        assert not reply.error
        with pytest.raises(RuntimeError):
            rig.reader.finish(rig.clock.now())

    # ------------------------------------------------------------------------------- reader and writer

    def test_a_reader_does_not_write(self, rig: DriverRig) -> None:
        before = rig.sent()
        with pytest.raises(TypeError):
            rig.reader.begin(WriteRequest({rig.reader.ids[0]: b"\1"}, 64), rig.clock.now())  # type: ignore[arg-type]
        assert rig.sent() == before

    def test_a_writer_does_not_ask(self, rig: DriverRig) -> None:
        before = rig.sent()
        with pytest.raises(TypeError):
            rig.writer.begin(ReadRequest(rig.reader.ids, 0, 4), rig.clock.now())  # type: ignore[arg-type]
        assert rig.sent() == before

    def test_reading_moves_nothing_and_changes_no_torque(self, rig: DriverRig) -> None:
        before = rig.places()
        rig.perform(rig.reader.identify())
        rig.ticks(20)
        assert (rig.places() == before).all()
        assert not rig.energised().any()

    def test_identify_lists_the_present_devices_in_order_of_ids(self, rig: DriverRig) -> None:
        rig.positions()
        found = rig.perform(rig.reader.identify())
        assert [device.id for device in found] == list(rig.reader.ids)
        for device in found:
            assert isinstance(device, IdentifiedDevice)
            for name in ("homing_offset", "drive_mode", "operating_mode"):
                assert isinstance(device.settings[name], int), name
            assert device.settings["min_position_limit"] <= device.settings["max_position_limit"]

    def test_a_device_without_a_reply_is_not_identified(self, rig: DriverRig) -> None:
        rig.positions()
        rig.faults.silence(rig.reader.ids[0])
        found = rig.perform(rig.reader.identify())
        assert [device.id for device in found] == list(rig.reader.ids[1:])

    def test_a_register_of_an_unknown_name_or_id_lists_what_there_is(self, rig: DriverRig) -> None:
        with pytest.raises(InvalidInput, match="temprature limt") as caught:
            rig.perform(rig.reader.read(rig.reader.ids[0], "temprature limt"))
        near = caught.value.near
        text = str(caught.value)
        assert all(each in text for each in near) and (near or "cubemars has no register" in text)
        with pytest.raises(KeyError, match=str(rig.reader.ids[0])):
            rig.perform(rig.reader.read(99, "hardware_error_status"))

    def test_the_hardware_error_is_read_by_its_name(self, rig: DriverRig) -> None:
        rig.arm()
        assert rig.beside(rig.reader.read(rig.reader.ids[0], "hardware_error_status")).value == 0

    def test_a_span_is_short_and_positive(self, rig: DriverRig) -> None:
        for _ in range(10):
            query = rig.reader.upkeep(rig.clock.now())
            assert query is None or 0.0 < rig.reader.span(query) < 0.005
            rig.tick()

    # ------------------------------------------------------------------------------- goals

    def test_goals_at_the_edges_pass_and_one_beyond_is_not_sent(self, rig: DriverRig) -> None:
        rig.writer.goals(rig.lower)
        rig.writer.goals(rig.upper)
        rig.writer.clear()
        for place in range(rig.m):
            for beyond in (rig.lower[place] - 1, rig.upper[place] + 1, 1 << 40, -(1 << 40)):
                goal = (rig.lower + rig.upper) // 2
                rig.writer.goals(goal)
                goal[place] = beyond
                with pytest.raises(WireRangeError) as told:
                    rig.writer.goals(goal)
                assert told.value.id == rig.reader.ids[place]

    def test_nothing_is_pending_after_a_goal_that_may_not_be_sent(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(20, here)
        rig.writer.goals(here + STEP)
        with pytest.raises(WireRangeError):
            rig.writer.goals(rig.upper + 1)
        before = rig.places()
        rig.ticks(5)
        assert abs(rig.places() - before).max() <= 3

    def test_goals_of_another_shape_are_refused(self, rig: DriverRig) -> None:
        with pytest.raises((ValueError, BusError)):
            rig.writer.goals(np.zeros(rig.m + 1, np.int64))

    def test_armed_devices_follow_and_each_reading_is_whole(self, rig: DriverRig) -> None:
        here = rig.arm()
        for cycle in range(60):
            goal = here + round(rig.stroke * np.sin(cycle / 15))
            sample = rig.tick(goal)
            assert sample.heard.all()
            assert not sample.foreign
            assert not sample.discarded
        assert abs(rig.places() - goal).max() < 0.4 * rig.stroke
        assert (rig.registers.torque == 1).all()

    def test_clear_drops_a_goal(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(20, here)
        before = rig.places()
        rig.writer.goals(here + 4 * STEP)
        rig.writer.clear()
        rig.ticks(5)
        assert abs(rig.places() - before).max() <= 3

    def test_a_cut_overtakes_goals_given_before_and_after_it(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(5, here)
        rig.writer.goals(here + 4 * STEP)
        rig.writer.cut()
        before = rig.places()
        rig.read(here + 4 * STEP)
        rig.clock.sleep_until(rig.clock.now() + 0.005)
        rig.read()
        assert not rig.energised().any()
        assert abs(rig.places() - before).max() <= 3

    def test_a_cut_leaves_with_the_next_query_too_and_outlives_clear(self, rig: DriverRig) -> None:
        rig.arm()
        rig.writer.cut()
        rig.writer.clear()
        rig.transact(
            ReadRequest((rig.reader.ids[0],), 0x1_0012, 3)
            if rig.name == "can"
            else ReadRequest(rig.reader.ids, 64, 1)
        )
        rig.clock.sleep_until(rig.clock.now() + 0.005)
        rig.read()
        assert not rig.energised().any()

    # ------------------------------------------------------------------------------- scripts

    def test_prepare_arms_the_watchdog_where_there_is_one_and_changes_no_torque(self, rig: DriverRig) -> None:
        here = rig.positions()
        rig.beside(rig.writer.prepare(here))
        assert not rig.energised().any()
        rig.ticks(30)
        assert np.isin(rig.registers.watchdog, (5, 100, -1)).all(), rig.registers.watchdog
        assert abs(rig.places() - here).max() <= 2

    def test_a_device_without_commands_trips_its_watchdog(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(5, here)
        watched = rig.registers.watchdog > 0
        rig.clock.sleep_until(rig.clock.now() + 0.5)
        rig.ticks(30, here)
        assert (rig.registers.watchdog[watched] == 255).all()

    def test_torque_is_read_back_on_and_off(self, rig: DriverRig) -> None:
        here = rig.arm()
        assert rig.energised().all()
        assert (rig.registers.torque == 1).all()
        rig.ticks(3, here)
        rig.beside(rig.writer.torque(False))
        assert not rig.energised().any()
        assert (rig.registers.torque == 0).all()

    def test_an_unconfirmed_torque_off_is_reported(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(3, here)
        rig.faults.silence(rig.reader.ids[1])
        with pytest.raises(NoReply) as told:
            rig.beside(rig.writer.torque(False))
        assert rig.reader.ids[1] in told.value.ids
        assert not np.delete(rig.energised(), 1).any(), "the others wait for nobody"

    def test_an_unconfirmed_preparation_is_reported(self, rig: DriverRig) -> None:
        here = rig.positions()
        rig.faults.silence()
        with pytest.raises(BusError):
            rig.beside(both(rig, here))

    def test_a_device_without_a_reply_does_not_prevent_the_preparation_of_others(
        self, rig: DriverRig
    ) -> None:
        here = rig.arm()
        rig.ticks(40, here)
        armed = rig.registers.watchdog[1:].copy()
        rig.clock.sleep_until(rig.clock.now() + 0.5)  # who has a watchdog stops, and must be prepared anew
        rig.ticks(5)
        rig.faults.silence(rig.reader.ids[0])
        with pytest.raises(NoReply) as told:
            rig.beside(both(rig, here))
        assert told.value.ids == rig.reader.ids[:1]
        rig.ticks(40, here)
        assert (rig.registers.watchdog[1:] == armed).all()

    def test_aim_refuses_what_may_not_be_sent(self, rig: DriverRig) -> None:
        rig.positions()
        for script in (rig.writer.write_goals, rig.writer.prepare):
            with pytest.raises(WireRangeError):
                rig.beside(script(rig.upper + 1))

    def test_aimed_is_what_was_sent_last(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(3, here + 7)
        assert (rig.beside(rig.writer.read_goals()) == here + 7).all()

    def test_damped_devices_keep_their_torque(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(3, here)
        unconfirmed = rig.beside(rig.writer.damp())
        assert set(unconfirmed) <= set(rig.reader.ids)
        assert rig.energised().all()
        for sample in rig.ticks(5, here):
            assert sample.heard.all()

    def test_a_restart_is_refused_while_torque_is_on(self, rig: DriverRig) -> None:
        here = rig.arm()
        rig.ticks(3, here)
        with pytest.raises(BusError):
            rig.beside(rig.writer.reboot(rig.reader.ids[0]))
        assert rig.energised().all()

    @pytest.mark.slow
    @pytest.mark.parametrize("what", ["identify", "prepare", "aim", "on", "off", "damp"])
    def test_a_script_may_be_closed_at_any_yield(self, fresh: Callable[[], DriverRig], what: str) -> None:
        steps = 0
        while not closed(fresh(), what, steps):
            steps += 1


def closed(rig: DriverRig, what: str, steps: int) -> bool:
    """Closed after so many steps a script leaves a driver that works; whether it had ended by then."""
    here = rig.positions()
    script = {
        "identify": rig.reader.identify,
        "prepare": lambda: rig.writer.prepare(here),
        "aim": lambda: rig.writer.write_goals(here),
        "damp": rig.writer.damp,
    }.get(what, lambda: rig.writer.torque(what == "on"))()
    if what == "on":
        rig.beside(both(rig, here))
    stepped = rig.stepped(script)
    ended = any(next(stepped, True) for _ in range(steps))
    script.close()
    rig.writer.clear()
    heard = rig.ticks(5)[-1].heard.all()
    assert heard or what == "on", "with torque of ours a CubeMars tells nothing but to a goal"
    rig.beside(rig.writer.torque(False))
    assert not rig.energised().any()
    rig.arm()
    assert rig.energised().all()
    return ended
