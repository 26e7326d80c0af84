"""The unit files, without a service manager: they are read as they are meant, allow no more than they say,
and agree with the design and with the code. What they do is shown in `tests/support/systemd/`."""

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.unit_file_parser import (
    CLIENTS,
    METRICS,
    ROS,
    SERVICES,
    SOCKETS,
    STREAM,
    SYSTEMD,
    UPLINK,
    Lines,
    read,
    unit,
    value,
    values,
)
from twind import cli
from twind.bridge.zenoh import zenoh_session
from twind.client.find_socket import socket_path
from twind.config.daemon_settings import places
from twind.ctl import ctl_main as ctl
from twind.learn.streaming import stream_command
from twind.listening_sockets import GROUPS, NAMES
from twind.loop.procedures import failsafe
from twind.loop.procedures.lowering import LETTING_GO
from twind.loop.process import realtime
from twind.observe import metrics
from twind.protocol.socket_paths import SYSTEM

INSTALL = SYSTEMD.parent / "packaging" / "install.sh"
EXAMPLES = SYSTEMD / "examples"
STOCK = Path("/usr/lib/systemd/system")
UNIT_USER = 993  # any that is not root


@pytest.fixture(scope="module")
def analyze() -> str:
    found = shutil.which("systemd-analyze")
    if found is None:
        pytest.skip("no systemd-analyze here")
    if not STOCK.is_dir():
        pytest.skip(f"no {STOCK} here: units of systemd's own that ours name")
    return found


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine's files: ours as they are installed, systemd's own units, programs that units name."""
    root = tmp_path_factory.mktemp("tree")
    environment = os.environ | {"DESTDIR": str(root), "LIB": "/usr/lib"}
    subprocess.run([INSTALL, "files"], env=environment, check=True)
    here = root / "usr/lib/systemd/system"
    for each in [*STOCK.glob("*.target"), *STOCK.glob("*.slice"), STOCK / "modprobe@.service"]:
        if each.exists():
            shutil.copy(each, here / each.name)
    shutil.copy(EXAMPLES / "twind-can@.service", here)
    programs = (
        "opt/twind/bin/twind",
        "opt/twind/bin/twindctl",
        "usr/bin/install",
        "sbin/ip",
        "sbin/modprobe",
    )
    for program in programs:
        (root / program).parent.mkdir(parents=True, exist_ok=True)
        (root / program).write_text("#!/bin/sh\n")
        (root / program).chmod(0o755)
    return root


def complaints(analyze: str, tree: Path, units: Sequence[str]) -> str:
    """Messages of systemd; a key that it does not know is told but is no failure of the program's own."""
    done = subprocess.run(
        [analyze, f"--root={tree}", "--man=no", "verify", *units], capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr + (f"exit status {done.returncode}" if done.returncode else "")


def test_systemd_reads_every_unit_without_a_word(analyze: str, tree: Path) -> None:
    assert complaints(analyze, tree, [*SERVICES, *CLIENTS, *SOCKETS, "twind-can@.service"]) == ""


def version_of_systemd(analyze: str) -> int:
    said = subprocess.run([analyze, "--version"], capture_output=True, text=True, check=True).stdout
    return int(said.split()[1])


@pytest.mark.parametrize("name", sorted(each.name for each in EXAMPLES.glob("*.conf")))
def test_systemd_reads_every_example_without_a_word(analyze: str, tree: Path, name: str) -> None:
    if name == "notify-reload.conf" and version_of_systemd(analyze) < 253:
        pytest.skip("Type=notify-reload is of systemd 253")
    folder = tree / "usr/lib/systemd/system/twind.service.d"
    folder.mkdir()
    try:
        shutil.copy(EXAMPLES / name, folder)
        assert complaints(analyze, tree, ["twind.service"]) == ""
    finally:
        shutil.rmtree(folder)


def test_a_mistake_in_a_unit_is_reported_by_systemd_analyze(analyze: str, tree: Path) -> None:
    folder = tree / "usr/lib/systemd/system/twind.service.d"
    folder.mkdir()
    try:
        (folder / "wrong.conf").write_text("[Service]\nProtectSystems=strict\n")
        assert "ProtectSystems" in complaints(analyze, tree, ["twind.service"])
    finally:
        shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("name", "most"),
    [*((name, 1.7) for name in SERVICES[:3]), *((name, 1.0) for name in ("twind-sim.service", *CLIENTS))],
)
def test_the_exposure_is_small(analyze: str, name: str, most: float) -> None:
    threshold = f"--threshold={most * 10:.0f}"
    command = [analyze, "security", "--offline=yes", "--no-pager", threshold, str(SYSTEMD / name)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-200:]
    score = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert score is not None
    assert float(score[1]) <= most


# -------------------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("name", ["twind.service", "twind@.service", "twind-sim.service"])
def test_the_numbers_are_those_of_the_design(name: str) -> None:
    lines = unit(name)
    found = {
        key: value(lines, key)
        for key in (
            "Type",
            "NotifyAccess",
            "WatchdogSec",
            "Restart",
            "RestartSec",
            "StartLimitBurst",
            "StartLimitIntervalSec",
            "TimeoutStopSec",
        )
    }
    assert found == {
        "Type": "notify",
        "NotifyAccess": "main",
        "WatchdogSec": "2",
        "Restart": "on-failure",
        "RestartSec": "200ms",
        "StartLimitBurst": "5",
        "StartLimitIntervalSec": "30",
        "TimeoutStopSec": "15",
    }
    assert value(lines, "RestartPreventExitStatus") == str(cli.USAGE)


@pytest.mark.parametrize("name", SERVICES[:3])
def test_the_loop_may_have_the_priority_and_the_memory_that_it_asks_for(name: str) -> None:
    lines = unit(name)
    assert int(value(lines, "LimitRTPRIO")) >= realtime.PRIORITY
    assert value(lines, "LimitMEMLOCK") == "infinity"
    assert not values(lines, "RestrictRealtime")


def test_the_fail_safe_is_given_the_time_that_it_takes() -> None:
    lines = unit("twind-failsafe@.service")
    assert value(lines, "Type") == "oneshot"
    assert value(lines, "Restart") == "no"
    assert (
        int(value(lines, "TimeoutStartSec")) >= failsafe.LONGEST + 5.0
    )  # to start Python, as it asks for more then
    assert (
        int(value(lines, "TimeoutStopSec")) >= failsafe.WITHIN + LETTING_GO + 5.0
    )  # a way that is gone on with
    assert not values(lines, "WatchdogSec")
    assert not values(lines, "OnFailure")


# ----------------------------------------------------------------------------- each says what the other says


def renamed(lines: Lines) -> Lines:
    """The plain unit, as one of several."""
    names = {
        "twind-failsafe@twind.service": "twind-failsafe@%i.service",
        "/opt/twind/bin/twind": "/opt/twind/bin/twind --config /etc/twind/%i.yaml --socket /run/twind/%i",
        "twind: robot daemon (buses, twin, gate)": "twind: robot daemon of %i (buses, twin, gate)",
    }
    reload = ("--socket /run/twind reload", "--socket /run/twind/%i reload")
    return [(section, key, names.get(given, given).replace(*reload)) for section, key, given in lines]


def test_an_instance_differs_from_the_plain_unit_in_names_alone() -> None:
    assert unit("twind@.service") == renamed(unit("twind.service"))


BRIDGES = ((ROS, ("twind: in", "twind: %i in")), (UPLINK, ("uplink", "uplink of %i")))
CAGE = "CapabilityBoundingSet"  # the first line of what a service may not
SOCKETS_ARE_MADE = {("Service", "ReadWritePaths", "-/run/twind"), ("Service", "SystemCallFilter", "@chown")}


def cage(lines: Lines) -> Lines:
    start = next(place for place, (_, key, _) in enumerate(lines) if key == CAGE)
    return [line for line in lines[start:] if line[0] == "Service"]


def test_the_fail_safe_may_what_the_daemon_may_but_make_sockets() -> None:
    daemon = [line for line in cage(unit("twind.service")) if line not in SOCKETS_ARE_MADE]
    assert cage(unit("twind-failsafe@.service")) == daemon
    for key in ("User", "SupplementaryGroups", "Environment", "StateDirectory", "UMask", "KillMode"):
        assert value(unit("twind-failsafe@.service"), key) == value(unit("twind.service"), key)


def test_a_simulation_has_no_device_and_no_network() -> None:
    lines = unit("twind-sim.service")
    for key in ("PrivateDevices", "PrivateNetwork", "RestrictRealtime"):
        assert value(lines, key) == "yes"
    assert value(lines, "RestrictAddressFamilies") == "AF_UNIX"
    assert not values(lines, "DeviceAllow")
    assert not values(lines, "SupplementaryGroups")
    assert "--mode sim" in value(lines, "ExecStart")


def test_the_metrics_unit_is_local_only_and_runs_as_a_dynamic_user() -> None:
    lines = unit("twind-metrics.service")
    assert (value(lines, "DynamicUser"), value(lines, "SupplementaryGroups")) == ("yes", GROUPS["observe"])
    assert (values(lines, "IPAddressDeny"), values(lines, "IPAddressAllow")) == (["any"], ["localhost"])
    for key in ("PrivateDevices", "PrivateUsers", "RestrictRealtime"):
        assert value(lines, key) == "yes"
    assert value(lines, "Environment") == f"LISTEN={metrics.LISTEN}"
    assert not [key for _, key, _ in lines if key in ("Requires", "BindsTo", "PartOf", "ReadWritePaths")]


def test_figures_of_an_instance_differ_in_names_alone() -> None:
    names = {
        "twind: figures for Prometheus": "twind: figures of %i for Prometheus",
        "twind.service": "twind@%i.service",
    }
    plain = [(section, key, names.get(given, given)) for section, key, given in unit(METRICS[0])]
    command = ("--socket /run/twind ", "--socket /run/twind/%i ")
    assert unit(METRICS[1]) == [(section, key, given.replace(*command)) for section, key, given in plain]


def test_the_stream_unit_has_no_device_and_only_the_observe_socket() -> None:
    lines = unit(STREAM[0])
    assert (value(lines, "DynamicUser"), value(lines, "SupplementaryGroups")) == ("yes", GROUPS["observe"])
    assert (value(lines, "PrivateDevices"), value(lines, "DevicePolicy")) == ("yes", "closed")
    assert (values(lines, "IPAddressDeny"), values(lines, "IPAddressAllow")) == (["any"], ["localhost"])
    assert f"URL={stream_command.URL}" in value(lines, "Environment").split()
    assert value(lines, "StateDirectory") != value(unit("twind.service"), "StateDirectory")
    assert not [key for _, key, _ in lines if key in ("Requires", "BindsTo", "PartOf", "ReadWritePaths")]
    assert cage(lines) == cage(unit(METRICS[0]))


@pytest.mark.parametrize(("units", "described"), [(STREAM, ("readings", "readings of %i")), *BRIDGES])
def test_a_client_of_an_instance_differs_in_names_alone(
    units: tuple[str, str], described: tuple[str, str]
) -> None:
    other = {
        "Description": described,
        "After": ("twind.service", "twind@%i.service"),
        "ExecStart": ("--socket /run/twind ", "--socket /run/twind/%i "),
        "EnvironmentFile": (".env", "-%i.env"),
        "StateDirectory": ("twind-stream", "twind-stream/%i"),
    }
    plain = [
        (part, key, given.replace(*other[key]) if key in other else given)
        for part, key, given in unit(units[0])
    ]
    assert unit(units[1]) == plain


@pytest.mark.parametrize("name", [units[0] for units, _ in BRIDGES])
def test_a_bridge_unit_has_no_device_local_network_only_and_no_commands_by_default(name: str) -> None:
    lines = unit(name)
    assert (value(lines, "DynamicUser"), value(lines, "SupplementaryGroups")) == ("yes", GROUPS["observe"])
    assert not [key for _, key, _ in lines if key in ("Requires", "BindsTo", "PartOf", "ReadWritePaths")]
    families = "RestrictAddressFamilies"
    assert value(lines, families) == value(unit(METRICS[0]), families) + " AF_NETLINK"  # which interfaces are
    assert [line for line in cage(lines) if line[1] != families] == [
        line for line in cage(unit(METRICS[0])) if line[1] != families
    ]


def test_an_uplink_looks_for_the_router_that_the_verb_looks_for() -> None:
    assert f"CONNECT={zenoh_session.LOCAL}" in value(unit(UPLINK[0]), "Environment").split()


@pytest.mark.parametrize("name", ["ros", "uplink"])
def test_each_example_drop_in_adds_to_a_bridge_only_its_named_permission(name: str) -> None:
    commands, elsewhere = (read(EXAMPLES / f"{name}-{what}.conf") for what in ("commands", "elsewhere"))
    assert commands == [("Service", "SupplementaryGroups", GROUPS["control"])]
    assert {key for part, key, _ in elsewhere if part == "Service"} <= {"IPAddressAllow", "LoadCredential"}
    told = {line.partition("=")[0] for line in (EXAMPLES / f"{name}.env").read_text().splitlines()}
    assert "OPTIONS" in told  # the words that the unit's command line takes


def test_a_daemon_that_is_given_up_is_followed_by_the_fail_safe_and_never_runs_beside_it() -> None:
    for name, instance in (("twind.service", "twind"), ("twind@.service", "%i")):
        safe = f"twind-failsafe@{instance}.service"
        assert value(unit(name), "OnFailure") == safe
        assert safe in values(unit(name), "After")
        assert not values(unit(name), "Conflicts")  # a start would end the fail-safe that it waits for


@pytest.mark.parametrize("name", ["twind.service", "twind@.service"])
def test_the_drivers_of_the_adapters_are_there_before_device_groups_are_looked_up(name: str) -> None:
    lines = unit(name)
    drivers_of_ports = ("ttyUSB", "ttyACM", "ttyAMA", "ttyTHS")
    assert values(lines, "DeviceAllow") == [f"char-{driver} rw" for driver in drivers_of_ports]
    drivers = "modprobe@usbserial.service modprobe@cdc_acm.service"
    assert value(lines, "Wants") == drivers
    assert drivers in values(lines, "After")


# ------------------------------------------------------------------------------ each says what the code says


@pytest.mark.parametrize("name", [*SERVICES, *CLIENTS])
def test_every_command_line_is_one_that_the_programs_take(name: str) -> None:
    lines = unit(name)
    for key in ("ExecStart", "ExecReload"):
        for line in values(lines, key):
            program, *words = line.replace("%i", "left").removesuffix(" $OPTIONS").split()
            assert program.startswith("/opt/twind/bin/")
            if program.endswith("/twind"):
                cli.parser().parse_args(words)
            else:
                assert ctl.command_parser(words).parse_args(words).verb is not None


@pytest.mark.parametrize("name", SERVICES)
def test_the_folders_in_a_unit_are_those_the_daemon_uses(name: str) -> None:
    lines = unit(name)
    environment = dict(pair.split("=") for pair in value(lines, "Environment").split())
    environment["STATE_DIRECTORY"] = f"/var/lib/{value(lines, 'StateDirectory')}"  # as systemd does
    found = places(environment, uid=UNIT_USER)
    assert found.config == Path("/etc", value(lines, "ConfigurationDirectory")) == Path("/etc/twind")
    assert found.state == Path("/var/lib/twind")
    assert str(found.sockets) == SYSTEM
    for writable in values(lines, "ReadWritePaths"):
        assert writable == f"-{SYSTEM}"


@pytest.mark.parametrize("name", NAMES)
def test_the_sockets_are_those_that_the_daemon_takes_and_the_client_looks_for(name: str) -> None:
    for suffix, folder, service in (("", "", "twind.service"), ("@", "/%i", "twind@%i.service")):
        lines = unit(f"twind-{name}{suffix}.socket")
        assert value(lines, "FileDescriptorName") == name
        assert value(lines, "ListenStream") == socket_path(SYSTEM + folder, name)
        assert value(lines, "SocketGroup") == GROUPS[name]
        assert value(lines, "SocketMode") == "0660"
        assert value(lines, "Service") == service
        made = values(lines, "ExecStartPre")  # as the user whose folder it is, or root would follow its links
        assert made == ([f"/usr/bin/install -d -m 0755 {SYSTEM}{folder}"] if folder else [])
        assert values(lines, "User") == ([value(unit(service.replace("%i", "")), "User")] if folder else [])


# --------------------------------------------------------------------------------------- users and folders


def needs(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"no {program} here")
    if os.geteuid() != 0:
        pytest.skip("only root may give files away")
    return found


def test_the_user_may_open_ports_and_give_the_sockets_to_their_groups(tmp_path: Path) -> None:
    program = needs("systemd-sysusers")
    shutil.copytree(SYSTEMD / "sysusers.d", tmp_path / "usr/lib/sysusers.d")
    (tmp_path / "etc").mkdir()
    subprocess.run([program, f"--root={tmp_path}", "twind.conf"], check=True, capture_output=True)
    user = (tmp_path / "etc/passwd").read_text().split(":")
    assert user[0] == value(unit("twind.service"), "User")
    assert user[5:] == ["/var/lib/twind", "/usr/sbin/nologin\n"]
    groups = dict(line.split(":x:") for line in (tmp_path / "etc/group").read_text().splitlines())
    for group in (*GROUPS.values(), value(unit("twind.service"), "SupplementaryGroups")):
        assert groups[group].split(":")[1] == user[0]


def test_the_folder_of_the_sockets_is_the_users_and_open_to_all_who_may_connect(tmp_path: Path) -> None:
    program = needs("systemd-tmpfiles")
    shutil.copytree(SYSTEMD / "tmpfiles.d", tmp_path / "usr/lib/tmpfiles.d")
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/passwd").write_text(f"twind:x:{UNIT_USER}:{UNIT_USER}::/:\n")
    (tmp_path / "etc/group").write_text(f"twind:x:{UNIT_USER}:\n")
    subprocess.run([program, "--create", f"--root={tmp_path}", "twind.conf"], check=True, capture_output=True)
    found = (tmp_path / SYSTEM.lstrip("/")).stat()
    assert (found.st_mode & 0o7777, found.st_uid, found.st_gid) == (0o755, UNIT_USER, UNIT_USER)


def test_the_can_interface_keeps_no_more_than_two_cycles() -> None:
    lines = read(EXAMPLES / "twind-can@.service")
    assert any("txqueuelen 48" in line for line in values(lines, "ExecStart"))
    assert value(lines, "CapabilityBoundingSet") == "CAP_NET_ADMIN"
