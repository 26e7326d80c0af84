"""`twindctl metrics` as it is scraped: by those who behave, and by those who do not."""

import asyncio
import gzip
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path

import pytest
from prometheus_client import make_wsgi_app
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from prometheus_client.parser import text_string_to_metric_families as older_text

from tests.support.metrics_messages import latency, state, status
from tests.support.processes import Daemon, simulated, until
from twind.client import Client, Refused
from twind.observe.measuring import metrics_http, metrics_ledger
from twind.observe.measuring.metrics_http import LONGEST, MetricsHttpHandler
from twind.observe.measuring.metrics_ledger import STALE, MetricsLedger
from twind.observe.measuring.metrics_server import registry

OPENMETRICS = {"Accept": "application/openmetrics-text;version=1.0.0"}
SINCE = 30.0  # s that a busy machine may take


def ctl(folder: Path, *words: str) -> list[str]:
    return [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(folder), "metrics", *words]


@contextmanager
def exporter(folder: Path, *words: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A `twindctl metrics` of that daemon, and the address it printed. It must end cleanly."""
    process = subprocess.Popen(
        ctl(folder, *words), stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def get(port: int, path: str = "/metrics", **fields: str) -> tuple[int, str, bytes]:
    """Status, content type, body."""
    connection = HTTPConnection("127.0.0.1", port, timeout=10.0)
    try:
        connection.request("GET", path, headers=fields or OPENMETRICS)
        answer = connection.getresponse()
        return answer.status, answer.getheader("Content-Type", ""), answer.read()
    finally:
        connection.close()


def samples(port: int) -> dict[str, list[tuple[dict[str, str], float]]]:
    """Samples of a scrape by name. The parser of the library refuses what is no OpenMetrics."""
    code, kind, body = get(port)
    assert code == 200 and kind.startswith("application/openmetrics-text; version=1.0.0")
    found: dict[str, list[tuple[dict[str, str], float]]] = {}
    for family in text_string_to_metric_families(body.decode()):
        for sample in family.samples:
            found.setdefault(sample.name, []).append((sample.labels, sample.value))
    return found


def total(port: int, name: str, **labels: str) -> float:
    return sum(value for found, value in samples(port).get(name, ()) if labels.items() <= found.items())


def wait(what: Callable[[], object], message: str) -> None:
    until(lambda: bool(what()), SINCE, message)


def test_metrics_follow_a_daemon_from_start_to_end_and_restart(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with simulated(folder) as daemon, exporter(folder, "--listen", "127.0.0.1:0") as (_, address):
        found = re.fullmatch(r"metrics +http://127\.0\.0\.1:(\d+)/metrics", address)
        assert found is not None
        port = int(found[1])
        wait(lambda: total(port, "twind_loop_lateness_seconds_count"), "no histogram is told")
        with Client(folder) as client:
            client.call("AcquireLease")
            points = [{"positions": [99.0], "time_from_start": 1.0}]
            with pytest.raises(Refused):
                client.call("SubmitTrajectory", trajectory={"joint_names": ["head_yaw"], "points": points})
            wait(lambda: total(port, "twind_refusals_total", code="POS_LIMIT") == 1, "no refusal")
            told = samples(port)
            robot = client.call("GetStatus", joints=True)
            ticks = robot["status"]["loop"]["ticks"]
        named = {labels["joint"]: value for labels, value in told["twind_joint_position_radians"]}
        for joint in robot["joints"]:
            assert named[joint["name"]] == pytest.approx(joint["position"], abs=1e-3)
        assert len(named) == 24
        assert told["twind_mode"] == [
            ({"twind_mode": mode}, mode == "sim") for mode in ("live", "mirror", "sim")
        ]
        assert abs(told["twind_loop_ticks_total"][0][1] - ticks) < 200
        begun = told["twind_loop_ticks_created"][0][1]
        assert begun == pytest.approx(time.time() - ticks / 100.0, abs=5.0)
        assert not [name for name in told if not name.startswith("twind_")], "figures of the exporter itself"

        daemon.end(signal.SIGKILL)
        wait(lambda: samples(port) == {"twind_up": [({}, 0.0)]}, "a daemon that is gone is still told of")
        with simulated(folder) as again:
            wait(lambda: total(port, "twind_up"), "the next daemon is not seen")
            assert total(port, "twind_loop_ticks_created") > begun
            # The exporter went on, and so does what it counted itself.
            assert total(port, "twind_refusals_total", code="POS_LIMIT") == 1
            check_one_that_hangs(again, port)
            once = subprocess.run(
                ctl(folder, "--once", "--text"), capture_output=True, text=True, timeout=20.0
            )
            assert once.returncode == 0
            read = {family.name for family in older_text(once.stdout)}
            assert {"twind_up", "twind_state", "twind_loop_ticks", "twind_loop_lateness_seconds"} <= read
            again.end()
    gone = subprocess.run(ctl(folder, "--once"), capture_output=True, text=True, timeout=20.0)
    assert gone.returncode == 3 and "no daemon" in gone.stderr
    assert [line for line in gone.stdout.splitlines() if line[0] != "#"] == ["twind_up 0.0"]


def check_one_that_hangs(daemon: Daemon, port: int) -> None:
    """Loop and front stand still, their sockets stay."""
    both = (daemon.process.pid, daemon.front())
    for pid in both:
        os.kill(pid, signal.SIGSTOP)
    try:
        wait(lambda: samples(port) == {"twind_up": [({}, 0.0)]}, "a daemon that hangs is still told of")
    finally:
        for pid in both:
            os.kill(pid, signal.SIGCONT)


def test_a_unix_socket_is_served_and_taken_away(tmp_path: Path) -> None:
    place = tmp_path / "metrics.sock"
    with exporter(tmp_path, "--unix", str(place)) as (_, address):
        assert str(place) in address
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(10.0)
            client.connect(str(place))
            client.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
            answer = b"".join(iter(lambda: client.recv(65536), b""))
        assert b"twind_up 0.0" in answer
    assert not place.exists()


# ------------------------------------------------------------------------------------------- at the door


@contextmanager
def door(patience: float = 5.0) -> Iterator[int]:
    """Port of a metrics server in a thread of its own, for a robot of two joints."""
    ledger = MetricsLedger(0.0)
    loop = asyncio.new_event_loop()
    listener = socket.create_server(("127.0.0.1", 0), backlog=256)

    async def tell() -> None:
        while True:
            for message in (status(), state(), latency(None)):
                ledger.take(message, time.monotonic(), time.time())
            await asyncio.sleep(STALE / 4)

    async def serve() -> None:
        handler = MetricsHttpHandler(make_wsgi_app(registry(ledger)))
        async with await asyncio.start_server(handler, sock=listener, limit=LONGEST):
            await tell()

    before = metrics_http.PATIENCE
    metrics_http.PATIENCE = patience
    with ThreadPoolExecutor(1) as pool:
        task = loop.create_task(serve())
        done = pool.submit(loop.run_until_complete, asyncio.wait([task]))
        try:
            yield listener.getsockname()[1]
        finally:
            loop.call_soon_threadsafe(task.cancel)
            done.result(10.0)
            metrics_http.PATIENCE = before
            loop.close()


def http_reply(port: int, data: bytes) -> bytes:
    """Everything that is answered to these bytes, until the other side hangs up."""
    with socket.create_connection(("127.0.0.1", port), 10.0) as client:
        answer = b""
        try:
            client.sendall(data)
            while part := client.recv(65536):
                answer += part
        except (ConnectionResetError, BrokenPipeError):
            pass  # it did not want to read all of it
        return answer


def test_a_hundred_at_once_get_the_same_whole_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    patience = 3 * STALE  # s; a busy machine feeds the ledger late
    monkeypatch.setattr(metrics_ledger, "STALE", patience)
    with door() as port, ThreadPoolExecutor(100) as pool:
        found = [each.result() for each in [pool.submit(get, port) for _ in range(100)]]
    assert {code for code, _, _ in found} == {200}
    ages = [
        float(age)
        for _, _, body in found
        for age in re.findall(rb"^twind_news_age_seconds (\S+)", body, re.M)
    ]
    assert len(ages) == 100
    print(f"oldest news of 100 scrapes at once: {max(ages):.3f} s")
    assert max(ages) < 2 * STALE  # the feed, one each quarter of STALE, has its turn among the scrapes
    kept = {re.sub(rb"twind_news_age_seconds \S+", b"", body) for _, _, body in found}
    assert len(kept) == 1 and kept.pop().endswith(b"# EOF\n")


def test_a_hanging_http_client_delays_no_other_and_is_disconnected() -> None:
    with door(patience=1.0) as port:
        begun = time.monotonic()
        hanging = [socket.create_connection(("127.0.0.1", port), 20.0) for _ in range(50)]
        for each in hanging[:25]:
            each.sendall(b"GET /metrics HTTP/1.1\r\nX-Slow: ")
        assert get(port)[0] == 200
        assert time.monotonic() - begun < 1.0, "it waited for those who hang"
        for each in hanging:
            assert each.recv(1) == b""
            each.close()


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n", b"400"),
        (b"rubbish\r\n\r\n", b"400"),
        (b"GET /metrics FTP/1.0\r\n\r\n", b"505"),
        (b"GET /metrics HTTP/1.1\r\nAccept: application/openmetrics-text;version=x.y\r\n\r\n", b"400"),
        (b"GET /metrics HTTP/1.1\r\nHost: evil.example:9797\r\n\r\n", b"421"),
        (b"GET /../etc/passwd HTTP/1.1\r\n\r\n", b"404"),
        (b"POST /metrics HTTP/1.1\r\n\r\n", b"405"),
        (b"GET / HTTP/1.1\r\n\r\n", b"200"),
    ],
)
def test_an_invalid_http_request_gets_its_error_code_and_harms_no_other(data: bytes, code: bytes) -> None:
    with door() as port:
        assert http_reply(port, data).split()[1] == code
        assert get(port)[0] == 200


def test_a_request_without_end_is_not_read_to_its_end() -> None:
    with door() as port:
        answer = http_reply(port, b"GET /metrics HTTP/1.1\r\nX: " + 100 * LONGEST * b"x")
        assert answer == b"" or answer.split()[1] == b"431"  # hanging up may overtake the answer
        assert get(port)[0] == 200


def test_the_format_is_the_one_that_is_asked_for() -> None:
    with door() as port:
        _, kind, body = get(port, Accept="text/plain")
        assert kind.startswith("text/plain; version=0.0.4") and b"# EOF" not in body
        assert {family.name for family in older_text(body.decode())} >= {"twind_up", "twind_state"}
        packed = get(port, **{"Accept-Encoding": "gzip"})[2]
        assert len(packed) < len(body) / 3 and b"twind_up 1.0" in gzip.decompress(packed)


def test_a_socket_whose_name_is_no_text_is_served_too(tmp_path: Path) -> None:
    place = tmp_path / os.fsdecode(b"\xff.sock")
    with exporter(tmp_path, "--unix", str(place)) as (_, address):
        assert address.startswith("metrics") and place.is_socket()
