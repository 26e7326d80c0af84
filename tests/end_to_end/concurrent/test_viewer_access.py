"""Access to the viewer of a real viser server: other pages, other names and other users are refused."""

import http.client
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from socket import SHUT_RDWR, SHUT_WR, create_connection
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

import viser
from viser import _messages
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.support.processes import until
from twind.exceptions import OperationFailed
from twind.observe.viewing.viewer_access import STRANGERS, ViewerAccess, ViewerSite, opened


@pytest.fixture(scope="module")
def site() -> Iterator[ViewerSite]:
    os.environ["_VISER_PORT_OVERRIDE"] = "1"  # of another program that uses viser
    with opened(None, "test") as found:
        yield found


def asked(site: ViewerSite, path: str | None = None, **headers: str) -> tuple[int, http.client.HTTPMessage]:
    """Status and headers of an answer."""
    parts = urlsplit(site.url)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=5.0)
    connection.request("GET", parts.path if path is None else path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status, answer.headers


def socket(site: ViewerSite, path: str | None = None, **headers: str | None) -> None:
    """A WebSocket as the page opens it, but for what is named. Raises InvalidStatus."""
    parts = urlsplit(site.url)
    where = parts.path if path is None else path
    asked = {"Origin": f"http://{parts.netloc}"} | headers
    told = {key: value for key, value in asked.items() if value is not None and key != "Origin"}
    protocol = [f"viser-v{viser.__version__}"]
    with connect(
        f"ws://{parts.netloc}{where}",
        origin=asked["Origin"],  # type: ignore[arg-type]
        additional_headers=told,
        subprotocols=protocol,  # type: ignore[arg-type]
        open_timeout=5.0,
    ):
        pass


def test_the_page_comes_by_its_address_alone(site: ViewerSite) -> None:
    assert asked(site)[0] == 200
    for path in ("/", "/index.html", "/wrong/", "//", site_path(site)[:-2] + "/", "/a" + site_path(site)):
        assert asked(site, path)[0] == 403, path


def site_path(site: ViewerSite) -> str:
    return urlsplit(site.url).path


def test_a_foreign_page_opens_no_socket(site: ViewerSite) -> None:
    port = urlsplit(site.url).port
    socket(site)
    for origin in ("http://evil.example", "null", f"http://localhost:{port}", "http://127.0.0.1", None):
        with pytest.raises(InvalidStatus, match="403"):
            socket(site, Origin=origin)


def test_a_socket_needs_the_secret(site: ViewerSite) -> None:
    for path in ("/", "/wrong"):
        with pytest.raises(InvalidStatus, match="403"):
            socket(site, path)


def test_a_name_that_was_bound_anew_is_another_host(site: ViewerSite) -> None:
    assert asked(site, Host=f"evil.example:{urlsplit(site.url).port}")[0] == 403
    assert asked(site, Host="127.0.0.1.evil.example")[0] == 403
    assert asked(site, Host="[::1")[0] == 403
    assert asked(site, Host="localhost:9000")[0] == 200  # by ssh -L 9000:127.0.0.1:PORT


def test_an_upgrade_header_does_not_bypass_the_origin_check(site: ViewerSite) -> None:
    assert asked(site, Upgrade="WebSocket", Origin="http://evil.example")[0] == 403
    assert asked(site, Upgrade="WebSocket")[0] == 403


def test_the_page_may_ask_no_other_host_and_stands_in_no_frame(site: ViewerSite) -> None:
    _, headers = asked(site)
    policy = dict(each.strip().split(" ", 1) for each in headers["Content-Security-Policy"].split(";"))
    own = urlsplit(site.url).netloc
    assert policy["default-src"] == "'none'" and policy["frame-ancestors"] == "'none'"
    assert policy["connect-src"].split() == ["'self'", "data:", "blob:", f"ws://{own}"]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert asked(site, "/../../../etc/passwd")[0] == 403
    assert asked(site, site_path(site) + "../../_viser.py")[0] == 404


def test_no_page_can_have_it_published(site: ViewerSite) -> None:
    """One message of viser's protocol would make it dial out and serve this server on the internet."""
    handlers = site.server._websock_server._incoming_handlers
    assert _messages.ShareUrlRequest not in handlers and _messages.ShareUrlDisconnect not in handlers
    assert _messages.GuiUpdateMessage in handlers  # the table is the one that counts


def test_the_viewer_listens_only_on_loopback_whatever_the_environment(site: ViewerSite) -> None:
    port = urlsplit(site.url).port
    assert port != 1

    def listening(table: str) -> list[str]:
        rows = [line.split() for line in Path(table).read_text().splitlines()[1:]]
        return [row[1] for row in rows if row[3] == "0A" and row[1].endswith(f":{port:04X}")]

    assert listening("/proc/net/tcp") == [f"0100007F:{port:04X}"]
    assert not Path("/proc/net/tcp6").exists() or listening("/proc/net/tcp6") == []


def test_a_port_in_use_is_reported(site: ViewerSite) -> None:
    with pytest.raises(OperationFailed, match="is taken"), opened(urlsplit(site.url).port, "second"):
        pass


def test_two_viewers_have_two_secrets() -> None:
    assert ViewerAccess().secret != ViewerAccess().secret
    assert len(ViewerAccess().secret) >= 32


def test_a_viser_that_does_not_come_by_is_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one place that is not its interface: how it starts its server."""
    import websockets.asyncio.server as websockets

    from twind.observe.viewing import viewer_access

    before = websockets.serve

    @contextmanager
    def unguarded(*_: object) -> Iterator[list[bool]]:
        assert websockets.serve is before
        yield []

    monkeypatch.setattr(viewer_access, "_guarded", unguarded)
    with pytest.raises(OperationFailed, match="cannot be guarded"), opened(None, "test"):
        pass


def test_the_page_has_the_script_of_held_buttons(site: ViewerSite) -> None:
    parts = urlsplit(site.url)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=5.0)
    connection.request("GET", parts.path, headers={"Accept-Encoding": "gzip"})
    page = connection.getresponse().read()
    connection.close()
    assert page.count(b"visibilitychange") >= 1 and b"data-twind-kind" in page
    assert page.rindex(b"data-twind-kind") < page.rindex(b"</head>")


def drain(channel: Any) -> None:
    """Read until it is closed. Raises TimeoutError, ConnectionClosed."""
    while True:
        channel.recv(timeout=5.0)


def test_the_channel_of_the_page_passes_the_same_door_and_closes_on_what_is_no_message(
    site: ViewerSite,
) -> None:
    parts = urlsplit(site.url)
    address = f"ws://{parts.netloc}{parts.path}twind"
    for origin in ("http://evil.example", None):
        with pytest.raises(InvalidStatus, match="403"), connect(address, origin=origin):  # type: ignore[arg-type]
            pass
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(f"ws://{parts.netloc}/twind", origin=f"http://{parts.netloc}"),
    ):  # type: ignore[arg-type]
        pass
    press = {"press": 1, "kind": "up", "name": "head_yaw", "key": ""}
    with connect(address, origin=f"http://{parts.netloc}") as channel:  # type: ignore[arg-type]
        channel.send(json.dumps(press))
        answers = [json.loads(channel.recv(timeout=5.0)) for _ in range(3)]  # stops, token, answer
        assert any("--operate" in answer.get("text", "") for answer in answers)
    for wrong in ("", "[]", "7", "{}", '{"press": null}', '{"press": 1e999}', "[" * 900, " " * 1001, b"\xff"):
        with connect(address, origin=f"http://{parts.netloc}") as channel:  # type: ignore[arg-type]
            channel.send(wrong)
            with pytest.raises(ConnectionClosed):
                drain(channel)


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\n\r\nabc",
        b"PUT /x HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\r\n\r\n",
        b"GET /\xff HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.0\r\n\r\n",
        b"",
    ],
)
def test_a_request_that_is_no_get_of_the_page_is_refused_without_a_traceback(
    site: ViewerSite, request_bytes: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    with create_connection(("127.0.0.1", urlsplit(site.url).port), timeout=5.0) as end:
        end.sendall(request_bytes)
        if not request_bytes:
            end.shutdown(SHUT_WR)
        answer = b"".join(iter(lambda: end.recv(4096), b""))
    assert answer.startswith(b"HTTP/1.1 403") or request_bytes in (b"", b"GET / HTTP/1.0\r\n\r\n")
    assert asked(site)[0] == 200
    assert "".join(capfd.readouterr()) == ""


def test_connections_without_the_secret_take_no_more_than_their_share_of_descriptors(
    site: ViewerSite,
) -> None:
    """Each open descriptor of another user would be one less for the e-stop's connection."""
    parts = urlsplit(site.url)
    address = (parts.hostname, parts.port)
    before = len(os.listdir("/proc/self/fd"))
    idle = [create_connection(address, timeout=5.0) for _ in range(3 * STRANGERS)]
    try:
        idle[-1].sendall(b"GET /wrong/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert idle[-1].recv(100).startswith(b"HTTP/1.1 403")
        served = len(os.listdir("/proc/self/fd")) - before - len(idle)
        assert served <= STRANGERS
        socket(site)
        assert asked(site)[0] == 200
    finally:
        for each in idle:
            each.close()


def test_a_browser_that_is_gone_without_a_word_is_no_error(
    site: ViewerSite, capfd: pytest.CaptureFixture[str]
) -> None:
    parts = urlsplit(site.url)
    before = len(os.listdir("/proc/self/fd"))
    with connect(
        f"ws://{parts.netloc}{parts.path}twind",
        origin=f"http://{parts.netloc}",  # type: ignore[arg-type]
    ) as line:
        line.recv(timeout=5.0)
        line.socket.shutdown(SHUT_RDWR)
    until(lambda: len(os.listdir("/proc/self/fd")) <= before, 10.0, "the viewer has closed its end")
    assert asked(site)[0] == 200
    assert capfd.readouterr().err == ""
