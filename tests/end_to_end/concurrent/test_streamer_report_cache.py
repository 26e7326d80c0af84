"""Reports of streamers: published to subscribers, shown in the status, removed with their connection."""

from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.loop_stand_in import StandIn
from tests.support.raw_connection import CONTRACT, Raw
from twind import link
from twind.ctl.status_table import stream_text
from twind.front.streamer_report_cache import (
    COUNTS,
    GONE,
    HANGS,
    MOST,
    MOST_HZ,
    SILENCE,
    TEXT,
    StreamerReportCache,
    find_invalid_number,
)

REPORT = {
    "name": "a1b2",
    "endpoint": "http://localhost:8000/ingest",
    "rate_hz": 100.0,
    "sent": 12,
    "waiting": 1,
    "dropped": 0,
    "dead": 0,
    "failures": 2,
    "error": None,
}


class Watchers:
    def __init__(self) -> None:
        self.told: list[dict[str, Any]] = []
        self.streams: list[dict[str, Any]] = []

    def tell(self, streaming: dict[str, Any], time: float) -> None:
        self.told.append(streaming)

    def now(self, streams: list[dict[str, Any]]) -> None:
        self.streams = streams


def streams() -> tuple[StreamerReportCache, Watchers]:
    watchers: Any = Watchers()
    world = SimpleNamespace(stream=watchers.now)
    telemetry = SimpleNamespace(stream=watchers.tell)
    return StreamerReportCache(world, telemetry), watchers  # type: ignore[arg-type]


def test_the_last_word_of_each_connection_counts() -> None:
    kept, watchers = streams()
    kept.take(1, REPORT, 0.0)
    kept.take(2, {**REPORT, "name": "other"}, 0.1)
    kept.take(1, {**REPORT, "sent": 13}, 1.0)
    assert [each["sent"] for each in watchers.told] == [12, 12, 13]
    assert [(each["name"], each["sent"]) for each in watchers.streams] == [("a1b2", 13), ("other", 12)]


def test_a_streamer_that_disconnects_or_hangs_is_reported_once_more_and_removed() -> None:
    kept, watchers = streams()
    kept.take(1, REPORT, 0.0)
    kept.take(2, REPORT, 5.0)
    kept.forget(3, 6.0)
    kept.forget(2, 6.0)
    kept.drop_silent(SILENCE)
    assert [each["error"] for each in watchers.told] == [None, None, GONE]
    kept.drop_silent(SILENCE + 0.1)
    assert watchers.told[-1]["error"] == HANGS
    assert watchers.streams == []


def test_no_text_reaches_a_terminal_as_more_than_a_short_line() -> None:
    kept, watchers = streams()
    kept.take(1, {**REPORT, "name": "\x1b[2J", "endpoint": "\u202e" * 999, "error": "x" * 999}, 0.0)
    (told,) = watchers.streams
    assert told["name"] == "\\x1b[2J"
    assert all(len(each) <= TEXT and each.isprintable() for each in (told["endpoint"], told["error"]))


# ------------------------------------------------------------------------------------------ on the socket


def test_a_stream_report_of_an_observer_reaches_subscribers_but_not_the_loop(loop: StandIn) -> None:
    with Raw(loop, "observe") as watcher, Raw(loop, "observe") as streamer:
        watcher.send("Monitor", parameters={"topics": ["stream"]}, more=True)
        assert "error" not in streamer.call("GetStatus")
        assert streamer.call("ReportStream", stream=REPORT) == {"parameters": {}}
        told = watcher.receive()["parameters"]
        CONTRACT.methods["Monitor"].results.check(told, "")
        assert (told["topic"], told["stream"]) == ("stream", REPORT)
        status = streamer.call("GetStatus")["parameters"]["status"]
        CONTRACT.methods["GetStatus"].results.check({"status": status}, "")
        assert status["streams"] == [REPORT]
        streamer.socket.close()
        assert watcher.receive()["parameters"]["stream"] == {**REPORT, "error": GONE}
    with Raw(loop, "observe") as other:
        assert other.call("GetStatus")["parameters"]["status"]["streams"] == []
    assert not [command for command in loop.commands if isinstance(command, link.Command)]


def test_a_flood_of_stream_reports_is_refused_and_then_disconnected(loop: StandIn) -> None:
    with Raw(loop, "observe") as client:
        answers = []
        with suppress(EOFError, OSError):
            for _ in range(200):
                answers.append(client.call("ReportStream", stream=REPORT))
        assert client.ended()
    refused = [each for each in answers if "error" in each]
    assert len(answers) < 60
    assert {each["parameters"]["findings"][0]["code"] for each in refused} == {"RATE_LIMIT"}


@given(
    st.floats() | st.sampled_from([0.0, 100.0, MOST_HZ]),
    st.sampled_from(COUNTS),
    st.integers(-2, 2) | st.integers(MOST - 1, MOST + 1) | st.integers(),
)
def test_an_impossible_rate_or_count_is_named(rate: float, key: str, count: int) -> None:
    found = find_invalid_number({**REPORT, "rate_hz": rate, key: count})
    if 0.0 <= rate <= MOST_HZ:
        assert (found and found[0]) == (None if 0 <= count <= MOST else key)
    else:
        assert found is not None and found[0] == "rate_hz"


@pytest.mark.parametrize("rate", [0.0, 0.25, 99.97, MOST_HZ])
def test_a_valid_stream_report_fits_a_line(rate: float) -> None:
    text = stream_text(
        {**REPORT, "rate_hz": rate, **dict.fromkeys(COUNTS, MOST), "endpoint": "", "error": ""}
    )
    assert len(text) < 160


@pytest.mark.parametrize("wrong", [{"sent": -5}, {"dropped": -1}, {"waiting": 2**62}, {"rate_hz": 1e300}])
def test_a_report_with_such_a_number_is_refused_by_its_name(loop: StandIn, wrong: dict[str, Any]) -> None:
    [key] = wrong
    with Raw(loop, "observe") as client:
        answer = client.call("ReportStream", stream={**REPORT, **wrong})
        assert answer["parameters"]["parameter"] == f"stream.{key}"
        assert client.call("GetStatus")["parameters"]["status"]["streams"] == []


@pytest.mark.parametrize(
    "wrong", [{}, {"stream": {}}, {"stream": {**REPORT, "sent": 1.5}}, {"stream": {**REPORT, "x": 1}}]
)
def test_an_invalid_stream_report_is_refused(loop: StandIn, wrong: dict[str, Any]) -> None:
    with Raw(loop, "observe") as client:
        assert client.call("ReportStream", **wrong)["error"].endswith("InvalidParameter")
