"""The example files of a router that asks who comes, and of who comes: real certificates, a real router."""

import json
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.support.certificates import Authority
from tests.support.processes import Daemon, simulated, until
from tests.support.uplink_rig import PATIENCE, Far, Uplink, ended, phases, up
from tests.support.zenoh_router import Router
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now
from twind.client.errors import ClientError

EXAMPLES = Path(__file__).parents[3] / "systemd" / "examples"
# as the example of the router has them
ROBOT = "h24-007"
OTHER = "h24-008"
CREDENTIALS = "/run/credentials/twind-uplink.service"


class Ground:
    """An authority, a router by the example, and a robot that may be called ROBOT."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authority = Authority(folder / "authority")
        certificate, key = self.authority.sign("router")
        said = (EXAMPLES / "zenoh-router.json5").read_text()
        for name, path in {"ca": self.authority.certificate, "cert": certificate, "key": key}.items():
            said = said.replace(f"/etc/zenoh/{name}.pem", str(path))
        assert "/etc/" not in said.partition("{")[2], "every path of the example is replaced"
        (folder / "router.json5").write_text(said)
        self.router = Router(scheme="tls", file=folder / "router.json5")
        self.endpoint = self.router.endpoint.replace("127.0.0.1", "localhost")

    def file(self, name: str, authority: Authority | None = None) -> Path:
        """Configuration by the example, with the certificate of `name`."""
        certificate, key = (authority or self.authority).sign(name)
        said = (EXAMPLES / "uplink.json5").read_text()
        for part, path in {"ca": self.authority.certificate, "cert": certificate, "key": key}.items():
            said = said.replace(f"{CREDENTIALS}/{part}.pem", str(path))
        made = self.folder / f"{name}.json5"
        made.write_text(said)
        return made

    def place(self, name: str) -> NetworkConfig:
        return NetworkConfig(connect=(self.endpoint,), file=self.file(name))

    def uplink(self, sockets: Path, certificate: str, name: str) -> Uplink:
        words = ("--connect", self.endpoint, "--zenoh-config", str(self.file(certificate)), "--name", name)
        return Uplink(sockets, *words)


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    made = Ground(tmp_path_factory.mktemp("ground"))
    yield made
    made.router.kill()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("run")) as running:
        yield running


@pytest.fixture(scope="module")
def robot(ground: Ground, daemon: Daemon) -> Iterator[Uplink]:
    with ended() as brief:
        uplink = brief(ground.uplink(daemon.sockets, ROBOT, ROBOT))
        with closing(Far(ground.place("operator"), ROBOT)) as far:
            up(far, uplink)
        yield uplink


def silent(far: Far, *parts: str, **asked: Any) -> bool:
    """Nobody answers: the router let no such question through."""
    answer = far.ask(*parts, **asked)
    assert answer in ({}, {"error": "Timeout"}), answer
    return True


def test_a_certificate_listed_as_observer_reads_everything_and_commands_nothing(
    ground: Ground, robot: Uplink
) -> None:
    with closing(Far(ground.place("observer"), ROBOT)) as far:
        assert far.there()
        state = far.listen("state", "10")
        status = far.listen("news", "status")
        assert far.ask("ask", "GetStatus")["status"]["mode"] == "sim"
        until(lambda: len(state) > 2 and status, PATIENCE, "what is told")
        assert silent(far, "lease", op="acquire", holder="observer")
        assert silent(far, "goal", goal="g", lease="l", deadline=time.monotonic(), trajectory={})
        assert silent(far, "stop", "Cancel")
        assert silent(far, "check", trajectory={})
        assert far.ask("stop", "EStop", level=3)["parameters"]["parameter"] == "level", "it gets there"


def test_a_certificate_listed_as_operator_moves_the_robot(ground: Ground, robot: Uplink) -> None:
    with closing(Far(ground.place("operator"), ROBOT)) as far:
        told = far.listen("goals", "*")
        with far.holding() as lease:
            assert far.goal("bend", lease, 0.2, 1.0)["phase"] == "accepted"
            until(lambda: phases(told)[-1:] == ["succeeded"], PATIENCE, f"it moves: {told}")
        assert far.ask("stop", "Cancel")["state"] == "disconnected"


def test_a_robot_certificate_publishes_for_no_other_robot(
    ground: Ground, daemon: Daemon, robot: Uplink
) -> None:
    with closing(Far(ground.place("operator"), ROBOT)) as far, ended() as brief:
        false = brief(ground.uplink(daemon.sockets, OTHER, ROBOT))
        until(lambda: "is up" in false.output, PATIENCE, "for itself it is up")
        heard = far.listen("news", "*")
        with open_now(ground.place(OTHER), PATIENCE) as other, open_now(ground.place(ROBOT), PATIENCE) as own:
            other.put(f"twind/{ROBOT}/news/status", f"said as {OTHER}".encode())
            own.put(f"twind/{ROBOT}/news/status", f"said as {ROBOT}".encode())
            until(lambda: f"said as {ROBOT}".encode() in heard, PATIENCE, "the true one is heard")
            time.sleep(0.5)
        assert f"said as {OTHER}".encode() not in heard
        for _ in range(5):
            assert far.ask("ask", "GetStatus")["status"]["robot"] == "h24"
        _, out = false.end()
        assert json.loads(out)["lanes"]["asking"]["answered"] == 0, "what was asked went to the true one"


# What a robot alone may say: where it is asked, and what it tells.
ASKED_AT = ("lease", "goal", "check", "stop/Cancel", "stop/EStop", "ask/GetStatus")
TOLD_AT = ("state/10", "news/events", "goals/mine")


@pytest.mark.parametrize("subject", ["operator", "observer", OTHER])
def test_only_the_robot_itself_answers_and_publishes_for_it(
    ground: Ground, robot: Uplink, subject: str
) -> None:
    """The liar says that it has all the answers, which a router prefers to who does not say so."""
    seen: list[str] = []

    def lie(query: zenoh.Query) -> None:
        with query:
            seen.append(str(query.key_expr))
            query.reply(query.key_expr, b'{"state":"LIE","lease":"LIE","phase":"succeeded"}')

    with (
        open_now(ground.place(subject), PATIENCE) as liar,
        closing(Far(ground.place("operator"), ROBOT)) as far,
    ):
        told = [far.listen(*each.split("/")) for each in TOLD_AT]
        for each in (*ASKED_AT, "**"):
            liar.declare_queryable(f"twind/{ROBOT}/{each}", lie, complete=True)
        liar.liveliness().declare_token(f"twind/{ROBOT}/alive/0")  # whose number is the smallest has the name
        liar.liveliness().declare_token("twind/nobody/alive")
        until(lambda: told[0], PATIENCE, "what is told gets through")
        for each in TOLD_AT:
            liar.put(f"twind/{ROBOT}/{each}", b"LIE")
        time.sleep(1.0)
        for each in ASKED_AT:  # what is none is refused by the robot, and known by that
            answer = far.ask(*each.split("/"), nonsense=True)
            assert answer.get("error", "").endswith("InvalidParameter"), (each, answer)
        assert far.ask("stop", "Cancel")["state"] == "disconnected"
        assert seen == [] and not any(b"LIE" in heard for heard in told)
        living = far.session.liveliness().get("twind/nobody/alive", timeout=2.0)
        assert not any(reply.ok for reply in living)
        assert robot.process.poll() is None, "nor is its name taken from it"


def test_an_observer_asks_for_nothing_that_he_may_not_by_whatever_key(ground: Ground, robot: Uplink) -> None:
    with open_now(ground.place("observer"), PATIENCE) as session:
        for key in (
            "twind/**",
            "twind/*/stop/*",
            "twind/*/lease",
            f"twind/{ROBOT}/*",
            f"twind/{ROBOT}/check",
        ):
            replies = session.get(key, payload=b"{}", timeout=1.5, target=zenoh.QueryTarget.ALL)
            answered = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
            assert answered == set(), key


def test_a_certificate_of_another_authority_or_none_is_refused(ground: Ground, tmp_path: Path) -> None:
    stranger = ground.file("operator", Authority(tmp_path / "strangers"))
    plain = tmp_path / "plain.json5"
    plain.write_text(
        f'{{transport: {{link: {{tls: {{root_ca_certificate: "{ground.authority.certificate}"}}}}}}}}'
    )
    for file in (stranger, plain):
        with pytest.raises(ClientError, match="localhost"):
            open_now(NetworkConfig(connect=(ground.endpoint,), file=file), 2.0)
    with pytest.raises(ClientError):
        open_now(NetworkConfig(connect=(ground.endpoint.replace("tls/", "tcp/"),)), 2.0)


def test_a_router_with_a_certificate_of_another_authority_is_refused(ground: Ground, tmp_path: Path) -> None:
    strangers = Authority(tmp_path / "strangers")
    certificate, key = strangers.sign("router")
    said = (ground.folder / "router.json5").read_text()
    own = (ground.folder / "authority" / "router.pem", ground.folder / "authority" / "router.key")
    for mine, theirs in zip(own, (certificate, key), strict=True):
        said = said.replace(str(mine), str(theirs))
    (tmp_path / "router.json5").write_text(said)
    with Router(scheme="tls", file=tmp_path / "router.json5") as false:
        endpoint = false.endpoint.replace("127.0.0.1", "localhost")
        with pytest.raises(ClientError):
            open_now(NetworkConfig(connect=(endpoint,), file=ground.file("operator")), 2.0)
