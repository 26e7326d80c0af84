"""Sessions join exactly the Zenoh network that the options name."""

import argparse
import socket
import threading
import time
from pathlib import Path

import pytest

from tests.support.zenoh_router import free_port
from twind.bridge.zenoh import zenoh_session
from twind.bridge.zenoh.zenoh_session import LOCAL, NetworkConfig
from twind.client.errors import ClientError


def given(*words: str, **environ: str) -> NetworkConfig:
    parser = argparse.ArgumentParser()
    zenoh_session.add_options(parser)
    return zenoh_session.place(parser.parse_args(words), environ)


def test_without_a_word_it_is_the_router_of_this_machine() -> None:
    assert given() == NetworkConfig(connect=(LOCAL,))


def test_options_go_before_the_variable_which_holds_endpoints_or_a_file() -> None:
    assert given(TWIND_ZENOH="tcp/a:1, tls/b:2") == NetworkConfig(connect=("tcp/a:1", "tls/b:2"))
    assert given(TWIND_ZENOH="/etc/z.json5") == NetworkConfig(file=Path("/etc/z.json5"))
    assert given("--connect", "tcp/c:3", TWIND_ZENOH="tcp/a:1") == NetworkConfig(connect=("tcp/c:3",))
    assert given("--listen", "tcp/d:4", TWIND_ZENOH="tcp/a:1") == NetworkConfig(listen=("tcp/d:4",))


def test_unencrypted_endpoints_beyond_this_machine_are_named() -> None:
    place = NetworkConfig(
        connect=("tcp/localhost:1", "tcp/127.0.0.9:1", "tcp/[::1]:1", "tls/far:1", "quic/far:1", "tcp/far:1"),
        listen=("udp/0.0.0.0:2", "tcp/[::]:2"),
    )
    assert zenoh_session.readable(place) == ["tcp/far:1", "udp/0.0.0.0:2", "tcp/[::]:2"]


def test_unencrypted_endpoints_in_a_file_are_named(tmp_path: Path) -> None:
    said = tmp_path / "z.json5"
    said.write_text(
        '{mode: "peer", connect: {endpoints: ["tcp/203.0.113.5:1", "tls/far:1"]},'
        ' listen: {endpoints: {router: ["tcp/[::]:2"], peer: ["tcp/0.0.0.0:2", "tcp/[::1]:2"]}}}'
    )
    assert zenoh_session.readable(NetworkConfig(file=said)) == [
        "tcp/203.0.113.5:1",
        "tcp/[::]:2",
        "tcp/0.0.0.0:2",
    ]
    assert zenoh_session.readable(NetworkConfig(connect=("tls/near:1",), file=said)) == [
        "tcp/[::]:2",
        "tcp/0.0.0.0:2",
    ]
    said.write_text("{")
    with pytest.raises(ClientError, match=r"z\.json5"):
        zenoh_session.readable(NetworkConfig(file=said))


def test_a_session_neither_scouts_nor_listens_unless_a_file_enables_it(tmp_path: Path) -> None:
    said = tmp_path / "z.json5"
    said.write_text('{mode: "peer", connect: {endpoints: ["tcp/a:1"]}}')
    for place in (NetworkConfig(connect=("tcp/a:1",)), NetworkConfig(file=said)):
        made = zenoh_session.make_configuration(place, 1.0)
        assert (
            made.get_json("scouting/multicast/enabled") == made.get_json("scouting/gossip/enabled") == "false"
        )
        assert made.get_json("listen/endpoints") == "[]"
        assert made.get_json("connect/endpoints") == '["tcp/a:1"]'
    said.write_text(
        '{mode: "router", listen: {endpoints: ["tcp/a:2"]}, scouting: {multicast: {enabled: true}}}'
    )
    made = zenoh_session.make_configuration(NetworkConfig(file=said), 1.0)
    assert (made.get_json("mode"), made.get_json("listen/endpoints")) == ('"router"', '["tcp/a:2"]')
    assert made.get_json("scouting/multicast/enabled") == "true"


@pytest.mark.parametrize(
    "place", [NetworkConfig(connect=("nonsense",)), NetworkConfig(file=Path("/nowhere.json5"))]
)
def test_an_invalid_endpoint_raises_an_error_at_once_without_a_retry(place: NetworkConfig) -> None:
    with pytest.raises(ClientError, match=r"nonsense|nowhere") as told:
        zenoh_session.open_session(place, threading.Event(), lambda line: None)
    assert ".rs" not in str(told.value), "a place in somebody's source helps nobody"


def test_an_unreachable_endpoint_is_reported_once_and_retried_until_stopped() -> None:
    place = NetworkConfig(connect=(f"tcp/127.0.0.1:{free_port()}",))
    stop = threading.Event()
    lines = list[str]()
    with pytest.raises(ClientError, match=place.connect[0]):
        zenoh_session.open_now(place, 0.2)
    threading.Timer(2.5, stop.set).start()
    assert zenoh_session.open_session(place, stop, lines.append) is None
    assert len(lines) == 1 and place.connect[0] in lines[0]


def test_a_listening_session_opens_without_waiting_for_peers() -> None:
    place = NetworkConfig(connect=(f"tcp/127.0.0.1:{free_port()}",), listen=(f"tcp/127.0.0.1:{free_port()}",))
    begun = time.monotonic()
    with zenoh_session.open_now(place, 30.0):
        assert time.monotonic() - begun < 15.0
        host, port = place.listen[0].removeprefix("tcp/").split(":")
        socket.create_connection((host, int(port)), 5.0).close()


def test_a_closed_session_calls_no_callback_in_any_thread() -> None:
    """A callback that a daemon thread declared has a daemon thread: one that comes back from compiled code
    while the interpreter ends would abort the process."""
    joined = zenoh_session.open_now(NetworkConfig(listen=(f"tcp/127.0.0.1:{free_port()}",)), 30.0)
    heard = list[object]()

    def declare() -> None:
        joined.declare_subscriber("twind/robot/state/10", heard.append)

    declaring = threading.Thread(target=declare, daemon=True)
    declaring.start()
    declaring.join()
    mine = [each for each in threading.enumerate() if zenoh_session.CALLBACK in each.name and each.daemon]
    assert mine
    zenoh_session.close_session(joined)
    assert not [each for each in mine if each.is_alive()]
    assert joined.is_closed()
