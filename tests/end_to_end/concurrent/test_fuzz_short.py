"""A little of `make fuzz`, and whether it notices a parser and a reader that are broken on purpose."""

from dataclasses import replace

import pytest

from tests.proof.fuzz.__main__ import run
from tests.proof.fuzz.files import Files
from twind_drivers.bus import Bools
from twind_drivers.can.actuator_family import ActuatorFeedback
from twind_drivers.can.damiao_codec import DamiaoCodec
from twind_drivers.dynamixel.packet import Framer, Packet
from twind_drivers.ports.frame import Frames


@pytest.mark.parametrize(
    ("what", "count"),
    [("wire", 2000), ("checksum", 1000), ("can", 100_000), ("files", 60), ("settings", 100), ("cards", 300)],
)
def test_no_input_breaks_it(what: str, count: int) -> None:
    assert run(what, 4, 0, count) == 0


def test_no_frames_break_a_real_front() -> None:
    assert run("frames", 4, 0, 300) == 0


def test_a_parser_that_loses_packets_is_noticed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    feed = Framer.feed

    def forgetful(self: Framer, data: bytes) -> list[Packet]:
        return [found for found in feed(self, data) if found.id != 9]

    monkeypatch.setattr(Framer, "feed", forgetful)
    assert run("wire", 4, 0, 2000) == 1
    assert "SEED=4 FIRST=" in capsys.readouterr().out


def test_a_decoder_that_gives_a_row_the_values_of_another_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    feedback = DamiaoCodec.feedback

    def exchanged(self: DamiaoCodec, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        found, told = feedback(self, frames)
        return replace(found, position=found.position[::-1]), told

    monkeypatch.setattr(DamiaoCodec, "feedback", exchanged)
    assert run("can", 4, 0, 100_000) == 1


def test_a_reader_that_breaks_otherwise_than_by_refusing_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Files, "_read", lambda self, data, robot: int(data))
    assert run("files", 4, 0, 60) == 1
