"""Session of a ROS node over Zenoh: precedence of its settings, and the defaults."""

import json
from pathlib import Path
from typing import Any

import pytest

from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.bridge.ros.zenoh import ZenohTransport
from twind.bridge.ros.zenoh.zenoh_config import CONFIG, OVERRIDE, session_config
from twind.exceptions import OperationFailed


def configured(*keys: str, environment: dict[str, str] | None = None, **given: Any) -> list[Any]:
    config = session_config(environment or {}, given.get("connect"), given.get("file"))
    return [json.loads(config.get_json(key)) for key in keys]


def test_the_default_session_uses_the_local_router_and_no_multicast() -> None:
    mode, connect, listen, multicast = configured(
        "mode", "connect/endpoints", "listen/endpoints", "scouting/multicast/enabled"
    )
    assert (mode, connect) == ("peer", ["tcp/localhost:7447"])
    assert (listen, multicast) == (["tcp/localhost:0"], False)


def test_an_option_counts_before_the_variables_of_rmw_zenoh(tmp_path: Path) -> None:
    file = tmp_path / "session.json5"
    file.write_text('{mode: "client", connect: {endpoints: ["tcp/10.0.0.1:1"]}}')
    environment = {CONFIG: str(file)}
    assert configured("mode", "connect/endpoints", environment=environment) == ["client", ["tcp/10.0.0.1:1"]]
    one = configured("mode", "connect/endpoints", environment=environment, connect="tcp/a:1, tcp/b:2")
    assert one == ["peer", ["tcp/a:1", "tcp/b:2"]]
    other = tmp_path / "other.json5"
    other.write_text('{mode: "router"}')
    assert configured("mode", environment=environment, file=other) == ["router"]


def test_overrides_come_last() -> None:
    override = {OVERRIDE: 'mode="client"; connect/endpoints=["tcp/c:3"];'}
    assert configured("mode", "connect/endpoints", environment=override) == ["client", ["tcp/c:3"]]


def test_an_unreadable_session_setting_is_named(tmp_path: Path) -> None:
    with pytest.raises(OperationFailed, match=r"gone\.json5"):
        session_config({}, None, str(tmp_path / "gone.json5"))
    with pytest.raises(OperationFailed, match=OVERRIDE):
        session_config({OVERRIDE: "no/such/key=1"}, None, None)
    with pytest.raises(OperationFailed, match="nonsense"):
        session_config({}, "nonsense", None)


def test_messages_beyond_the_maximum_size_are_not_received() -> None:
    (most,) = configured("transport/link/rx/max_message_size")
    assert LONGEST < most <= 2 * LONGEST


@pytest.mark.parametrize(
    ("name", "value"),
    [("ROS_LOCALHOST_ONLY", "1"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"), ("ROS_STATIC_PEERS", "10.0.0.7")],
)
def test_a_variable_without_effect_over_zenoh_is_reported(
    name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    for each in ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"):
        monkeypatch.delenv(each, raising=False)
    ZenohTransport(DiscoverySettings(), told.append)
    assert told == []
    monkeypatch.setenv(name, value)
    ZenohTransport(DiscoverySettings(), told.append)
    assert told == [f"zenoh: {name}: ignored here; the router decides which nodes join"]
