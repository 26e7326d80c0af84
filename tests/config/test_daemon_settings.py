"""Settings: file, then command line over it; places by user; unknown keys refused."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from twind.config.daemon_settings import DaemonSettings, load_settings, places
from twind.config.yaml_tree import ConfigError

ENVIRON = {"HOME": "/home/ada", "XDG_RUNTIME_DIR": "/run/user/1000"}
FILE = """\
mode: live
robot: kid20.yaml
individual: kid20-b
ports: {main: /dev/ttyUSB0}
rate_hz: 200
sockets: /run/other
state_dir: /srv/twind
thresholds: {latency_warn_ms: 30, latency_block_ms: 80}
log_level: debug
cpu: 1
"""


def load(folder: Path, text: str = FILE) -> DaemonSettings:
    path = folder / "twind.yaml"
    path.write_text(text)
    return load_settings(path, ENVIRON, uid=1000)


def test_without_a_file_the_defaults_run_h24_in_mirror() -> None:
    settings = load_settings(None, ENVIRON, uid=1000)
    assert (settings.mode, settings.robot, settings.rate_hz) == ("mirror", "h24", None)
    assert (settings.latency_warn_ms, settings.latency_block_ms) == (50.0, 100.0)
    assert settings.socket_dir == Path("/run/user/1000/twind")


def test_every_key_of_a_file_is_taken(tmp_path: Path) -> None:
    settings = load(tmp_path)
    assert (settings.mode, settings.individual, settings.rate_hz) == ("live", "kid20-b", 200.0)
    assert settings.robot == str(
        tmp_path / "kid20.yaml"
    )  # beside the settings, wherever the daemon was started
    assert settings.ports == {"main": "/dev/ttyUSB0"}
    assert (settings.socket_dir, settings.state_dir) == (Path("/run/other"), Path("/srv/twind"))
    assert (settings.latency_warn_ms, settings.latency_block_ms, settings.log_level) == (30.0, 80.0, "debug")
    assert settings.cpu == 1
    assert settings.robot_folders[0] == tmp_path / "robots"
    assert settings.source == str(tmp_path / "twind.yaml")


def test_the_command_line_wins_over_the_file_key_by_key(tmp_path: Path) -> None:
    settings = load(tmp_path)
    assert settings.override() == settings
    changed = settings.override(
        mode="sim",
        robot="h24",
        calibration="c.yaml",
        socket="/run/s",
        rate_hz=50.0,
        ports=["main=/dev/a", "arms=/dev/b"],
    )
    assert (changed.mode, changed.robot, changed.rate_hz) == ("sim", "h24", 50.0)
    assert (changed.calibration, changed.socket_dir) == (Path("c.yaml"), Path("/run/s"))
    assert changed.ports == {"main": "/dev/a", "arms": "/dev/b"}
    assert changed.individual == "kid20-b"


def test_a_port_without_a_bus_stands_beside_those_of_the_file(tmp_path: Path) -> None:
    assert load(tmp_path).override(ports=["/dev/serial/by-id/usb-A=B"]).ports == {
        "main": "/dev/ttyUSB0",
        "": "/dev/serial/by-id/usb-A=B",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mode: mirrow\n", ":1:7: mode: 'mirrow' is none of sim, mirror, live; nearest: mirror"),
        ("mod: live\n", ":1:1: mod: unknown key; nearest: mode"),
        ("rate_hz: 5\n", "rate_hz: 5 is outside >= 10 and <= 1000"),
        ("rate_hz: 1e2\n", "1e2 is text in YAML"),
        ("individual: ../x\n", "use 1 to 64 of a-z"),
        ("cpu: -1\n", "cpu"),
        ("cpu: 1.5\n", "cpu"),
        ("log_level: verbose\n", "none of debug, info, warning, error"),
        (
            "ports: {main: 'can:can0'}\n",
            "ports.main: can:can0: a CAN port is can:INTERFACE:CHANNEL, as can:slc",
        ),
        ("ports: {main: 3}\n", "ports.main: text is expected"),
        ("thresholds: {latency_warn_ms: 60}\n", "60 is outside > 0 and <= 50"),
        ("thresholds: {latency_block_ms: 101}\n", "101 is outside > 0 and <= 100"),
        ("thresholds: {latency_block_ms: 40}\n", "40 is below latency_warn_ms, 50"),
        ("thresholds: {latency_ms: 40}\n", "latency_ms: unknown key"),
    ],
)
def test_a_wrong_setting_is_refused_at_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": "mirrow"}, "--mode mirrow is none of"),
        ({"rate_hz": 5.0}, "--rate 5 is outside 10 to 1000"),
        ({"rate_hz": float("nan")}, "--rate nan is outside"),
        ({"ports": ["/dev/a", "/dev/b"]}, "--port is given twice: /dev/a and /dev/b"),
        ({"ports": ["main=/dev/a", "main=/dev/b"]}, "--port is given for bus main twice"),
        ({"ports": [""]}, "--port is empty"),
        ({"ports": ["/dev/a", "main=/dev/b"]}, "--port /dev/a names no bus beside --port main=/dev/b"),
        ({"ports": ["main=/dev/b", "/dev/a"]}, "give every port as BUS=PORT"),
        ({"ports": ["main=can:slcan:"]}, "--port can:slcan:: a CAN port is can:INTERFACE:CHANNEL"),
    ],
)
def test_a_wrong_option_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_settings(None, ENVIRON, uid=1000).override(**change)  # type: ignore[arg-type]


def test_a_file_that_was_named_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        load_settings(tmp_path / "absent.yaml", ENVIRON, uid=1000)


@contextmanager
def closed(folder: Path) -> Iterator[None]:
    """A folder of mode 0000; root, whom no mode keeps out, becomes another user meanwhile."""
    folder.chmod(0o000)
    uid = os.geteuid()
    if uid == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(uid)
        folder.chmod(0o700)


def test_a_folder_that_we_may_not_enter_is_not_taken_for_an_empty_one(tmp_path: Path) -> None:
    (tmp_path / "twind").mkdir()
    (tmp_path / "calibration").mkdir()
    environ = {"XDG_CONFIG_HOME": str(tmp_path)}
    with closed(tmp_path / "twind"), pytest.raises(ConfigError) as caught:
        load_settings(None, environ, uid=1000)
    assert f"{tmp_path}/twind/twind.yaml: cannot be looked for: Permission denied; let uid" in str(
        caught.value
    )
    assert "--config FILE" in str(caught.value)
    settings = load(tmp_path, FILE.replace("/srv/twind", str(tmp_path)))
    with closed(tmp_path / "calibration"), pytest.raises(ConfigError) as caught:
        settings.calibration_path("kid20")
    assert "kid20-b.yaml: cannot be looked for: Permission denied" in str(caught.value)
    assert "--calibration FILE" in str(caught.value)


def test_a_folder_that_is_not_there_or_none_is_absent(tmp_path: Path) -> None:
    (tmp_path / "twind").write_text("")
    assert load_settings(None, {"XDG_CONFIG_HOME": str(tmp_path)}, uid=1000).source == "defaults"
    assert load_settings(None, {"XDG_CONFIG_HOME": str(tmp_path / "no")}, uid=1000).source == "defaults"


def test_the_usual_file_is_found_without_being_named(tmp_path: Path) -> None:
    environ = {"XDG_CONFIG_HOME": str(tmp_path)}
    (tmp_path / "twind").mkdir()
    (tmp_path / "twind/twind.yaml").write_text("mode: sim\n")
    assert load_settings(None, environ, uid=1000).mode == "sim"


def test_places_follow_the_user() -> None:
    root = places({}, 0)
    assert (str(root.config), str(root.state), str(root.sockets)) == (
        "/etc/twind",
        "/var/lib/twind",
        "/run/twind",
    )
    ada = places(ENVIRON, 1000)
    assert str(ada.config) == "/home/ada/.config/twind"
    assert str(ada.state) == "/home/ada/.local/state/twind"
    xdg = places({"XDG_CONFIG_HOME": "/c", "XDG_STATE_HOME": "/s", "XDG_RUNTIME_DIR": "/r"}, 1000)
    assert (str(xdg.config), str(xdg.state), str(xdg.sockets)) == ("/c/twind", "/s/twind", "/r/twind")
    assert str(places({"STATE_DIRECTORY": "/var/lib/twind:/x", "HOME": "/"}, 999).state) == "/var/lib/twind"


def test_the_calibration_is_that_of_the_individual_else_of_the_robot(tmp_path: Path) -> None:
    (tmp_path / "calibration").mkdir()
    text = FILE.replace("/srv/twind", str(tmp_path))
    assert load(tmp_path, text).calibration_path("kid20") is None
    for name in ("kid20", "kid20-b"):
        (tmp_path / f"calibration/{name}.yaml").touch()
    assert load(tmp_path, text).calibration_path("kid20") == tmp_path / "calibration/kid20-b.yaml"
    plain = load(tmp_path, text.replace("individual: kid20-b\n", ""))
    assert plain.calibration_path("kid20") == tmp_path / "calibration/kid20.yaml"
    assert plain.override(calibration="/absent.yaml").calibration_path("kid20") == Path("/absent.yaml")


def test_parameters_show_what_holds(tmp_path: Path) -> None:
    shown = load(tmp_path).parameters()
    assert (shown["mode"], shown["latency_warn_ms"], shown["log_level"]) == ("live", 30.0, "debug")
