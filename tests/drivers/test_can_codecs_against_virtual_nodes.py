"""The codecs against virtual actuators, which read and write the same bytes by code of their own."""

import struct

import numpy as np
import pytest

from tests.support.can_codec_frames import GAINS, column
from twind_drivers.can.actuator_family import ActuatorFamily, ActuatorFeedback, FieldRanges, ValuelessCommand
from twind_drivers.can.codec_factory import make
from twind_drivers.can.frame import Frames
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.can.can_loopback import CanLoopback
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus

MODELS = {"damiao": "DM4310", "cubemars": "AK70-10", "robstride": "RS01", "odrive": "ODrive"}
START = (0.4, -0.7)  # rad
LSB = 2 * 12.5 / 65535


class Bench:
    """Two actuators of one family on a virtual wire, and the codec that talks to them."""

    def __init__(self, name: str) -> None:
        self.clock = FakeClock()
        model = MODELS[name]
        nodes = [NodeSpec(id, model, feedback_id=id + 0x10 if name == "damiao" else 0) for id in (1, 2)]
        self.muscles = FirstOrderCanPhysics(column(*START))
        self.wire = CanLoopback(VirtualCanBus("leg", nodes, self.muscles), self.clock)
        spans = FieldRanges(*(np.full(2, most) for most in (12.5, 30.0, 10.0, *GAINS)))
        self.codec: ActuatorFamily = make(name, "virtual", [1, 2], [model] * 2, ranges=spans)
        self.run(1.0)  # awake

    def run(self, seconds: float) -> Frames:
        self.clock.sleep_until(self.clock.now() + seconds)
        return self.wire.receive(self.clock.now())

    def tell(self, frames: Frames) -> Frames:
        """Send, and what came back within 5 ms."""
        if len(frames):
            self.wire.send(frames, self.clock.now())
        return self.run(0.005)

    def command(self, position: tuple[float, float], kp: float = 40.0, kd: float = 2.0) -> Frames:
        zero = np.zeros(2)
        return self.codec.command(column(*position), zero, np.full(2, kp), np.full(2, kd), zero)

    def newest(self, frames: Frames) -> dict[str, list[float]]:
        """Of each actuator the last number that was told of each thing; NaN and -1: none was."""
        feedback, _ = self.codec.feedback(frames)
        return {
            name: _last(feedback, name) for name in ("position", "velocity", "effort", "enabled", "fault")
        }


def _last(feedback: ActuatorFeedback, name: str) -> list[float]:
    told = [np.nan, np.nan]
    for row, value in zip(feedback.rows, getattr(feedback, name), strict=True):
        if not np.isnan(value) and not (name in ("enabled", "fault") and value == -1):
            told[row] = float(value)
    return told


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_family_reports_its_positions(name: str) -> None:
    bench = Bench(name)
    asked = bench.codec.make_position_request()
    told = bench.tell(asked if len(asked) else bench.command((0.0, 0.0), 0.0, 0.0))
    assert bench.newest(told)["position"] == pytest.approx(START, abs=LSB)
    assert len(bench.codec.feedback(told)[0].rows) >= 2 * max(1, bench.codec.answers)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_actuators_hold_still_until_enabled_and_then_follow_commands(name: str) -> None:
    bench = Bench(name)
    goal = (1.2, -0.2)
    for _ in range(20):
        bench.tell(bench.command(goal))
    assert list(bench.muscles.position) == pytest.approx(START, abs=1e-6)
    gains = bench.codec.gains(np.full(2, 40.0), np.full(2, 2.0))
    heard = [bench.tell(gains)] if len(gains) else []
    heard += [
        bench.tell(bench.codec.encode_valueless_command(row, ValuelessCommand.ENABLE)) for row in range(2)
    ]
    heard += [bench.tell(bench.command(goal)) for _ in range(250)]
    told = bench.newest(np.concatenate(heard))
    assert list(bench.muscles.position) == pytest.approx(goal, abs=0.02)
    asked = bench.codec.make_position_request()
    last = bench.newest(bench.tell(asked if len(asked) else bench.command(goal)))
    assert last["position"] == pytest.approx(list(bench.muscles.position), abs=0.01)
    if name != "cubemars":  # does not tell
        assert told["enabled"] == [1.0, 1.0]
    assert told["fault"] == [0.0, 0.0]
    off = [
        bench.tell(bench.codec.encode_valueless_command(row, ValuelessCommand.DISABLE)) for row in range(2)
    ]
    off += [bench.tell(bench.codec.make_position_request()) for _ in range(50)]
    if name != "cubemars":
        assert bench.newest(np.concatenate(off))["enabled"] == [0.0, 0.0]


@pytest.mark.parametrize("name", ["damiao", "robstride"])
def test_the_watchdog_is_written_and_reads_back(name: str) -> None:
    bench = Bench(name)
    watchdog = bench.codec.watchdog
    assert watchdog is not None
    ticks = struct.pack("<I", 2000)
    answers = []
    for row in range(2):
        bench.tell(bench.codec.write(row, watchdog, ticks))
        answers += bench.codec.decode_register_replies(bench.tell(bench.codec.read(row, watchdog)))[0]
    assert [(answer.row, answer.address, answer.data) for answer in answers] == [
        (0, watchdog.address, ticks),
        (1, watchdog.address, ticks),
    ]


@pytest.mark.parametrize("name", ["damiao", "robstride", "odrive"])
def test_everything_that_identification_reads_is_answered(name: str) -> None:
    bench = Bench(name)
    for wanted in bench.codec.identity:
        parameter = bench.codec.parameters[wanted]
        answers, _ = bench.codec.decode_register_replies(bench.tell(bench.codec.read(1, parameter)))
        assert (1, parameter.address) in [(answer.row, answer.address) for answer in answers], wanted
