"""Units beside each other: sockets that start one, two robots, a simulation, settings that cannot be used."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import go
from tests.support.systemd.machine import NET_ADMIN, SYS_NICE, Failed, Machine
from tests.support.systemd.service import Service, drop_in, settings

MIRROR = {"mode": "mirror", "robot": "h24"}
SIM = {"mode": "sim", "robot": "h24"}
TOKEN = "not for everybody"
LEFT = "twind@left.service"
SIMULATION = "twind-sim.service"


def own_root(pid: int) -> Path:
    """The root folder of the mount namespace of a process."""
    return Path("/proc", str(pid), "root")


@pytest.fixture(scope="module")
def handed(machine: Machine) -> Iterator[Service]:
    """`twind@handed`, whose sockets systemd listens on; it runs as soon as somebody connects."""
    settings(machine, "handed", MIRROR)
    sockets = [f"twind-{name}@handed.socket" for name in ("control", "observe")]
    service = Service(machine, "twind@handed.service", "/run/twind/handed")
    service.reset()
    machine.run("systemctl", "start", *sockets)
    # They start while this one is tested.
    settings(machine, "left", SIM)
    if machine.may(SYS_NICE):
        drop_in(machine, LEFT, "realtime.conf")
    machine.inside("/run/token").write_text(TOKEN)
    machine.run(
        "systemd-creds", "encrypt", "--name=upload-token", "/run/token", "/etc/twind/upload-token.cred"
    )
    drop_in(machine, LEFT, "credentials.conf")
    if machine.may(NET_ADMIN):
        drop_in(machine, LEFT, "can.conf")
    machine.run("systemctl", "start", "--no-block", LEFT, SIMULATION)
    yield service
    machine.run("systemctl", "stop", *sockets)
    service.stop()


def test_the_first_connection_starts_the_service_and_is_answered(handed: Service) -> None:
    machine = handed.machine
    for name, group in (("control", "twind-operator"), ("observe", "twind-observe")):
        mode = machine.run("stat", "-c", "%a %U %G", f"/run/twind/handed/{name}.sock").split()
        assert mode == ["660", "twind", group]
    assert handed.show("ActiveState") == "inactive"
    refused = machine.try_run("twindctl", "--socket", "/run/twind/handed", "status", user="stranger")
    assert refused.returncode == 3
    assert handed.show("ActiveState") == "inactive", "who may not connect started it"
    said = machine.run("twindctl", "--socket", "/run/twind/handed", "status", user="watcher")
    assert "mirror" in said
    assert handed.show("ActiveState") == "active"
    machine.run("twindctl", "--socket", "/run/twind/handed", "estop", user="watcher")
    assert [fault["code"] for fault in handed.status()["faults"]]


def test_a_client_that_connects_during_a_restart_is_answered_by_the_next_daemon(handed: Service) -> None:
    assert handed.status()["mode"] == "mirror"
    main = handed.main()
    front = handed.front()
    handed.machine.kill(main)
    handed.machine.until(lambda: front not in handed.pids(), 5.0, "the end of its front")
    assert handed.status()["mode"] == "mirror"  # at once, and only one attempt
    assert handed.main() != main


@pytest.fixture(scope="module")
def left(machine: Machine, handed: Service) -> Iterator[Service]:
    """One of two robots, with FIFO from its unit."""
    service = Service(machine, LEFT, "/run/twind/left")
    service.until(ActiveState="active")
    yield service
    service.stop()


def test_the_unit_gives_fifo_where_limits_do_not_and_the_front_has_none(left: Service) -> None:
    if not left.machine.may(SYS_NICE):
        pytest.skip("PID 1 lacks CAP_SYS_NICE here: no unit gets FIFO")
    assert left.status()["loop"]["realtime"]["scheduler"] == "fifo 40"
    front = left.front()
    assert front is not None
    policies = [os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK for pid in (left.main(), front)]
    assert policies == [os.SCHED_FIFO, os.SCHED_OTHER]


def test_a_can_interface_that_is_not_there_holds_up_no_start(left: Service) -> None:
    if not left.machine.may(NET_ADMIN):
        pytest.skip("PID 1 lacks CAP_NET_ADMIN here: no unit gets it")
    assert "twind-can@can0.service" in left.show("After")
    assert not (own_root(left.main()) / "sys/class/net/can0").exists()
    front = left.front()
    assert front is not None
    rights = [
        re.findall(r"CapEff:\t(\w+)", Path(f"/proc/{pid}/status").read_text()) for pid in (left.main(), front)
    ]
    assert [int(each, 16) for (each,) in rights] == [1 << NET_ADMIN, 0]


def test_the_upload_token_is_for_the_service_alone(left: Service) -> None:
    place = f"/run/credentials/{LEFT}/upload-token"
    assert f"CREDENTIALS_DIRECTORY={Path(place).parent}" in left.environment()
    assert left.within("cat", place) == TOKEN
    for user in ("pilot", "stranger"):
        assert left.machine.try_run("cat", place, user=user).returncode != 0
    assert TOKEN not in left.machine.inside("/etc/twind/upload-token.cred").read_text()


def test_two_robots_run_beside_each_other(handed: Service, left: Service) -> None:
    assert (handed.status()["mode"], left.status()["mode"]) == ("mirror", "sim")
    for service, other in ((left, handed), (handed, left)):
        with service.client() as client:
            client.call("Reset")
        with other.client() as client:
            client.call("EStop")
        assert other.status()["faults"] and not service.status()["faults"]
    left.machine.kill(left.main())
    assert handed.status()["mode"] == "mirror"
    assert handed.show("ActiveState") == "active"


@pytest.fixture
def simulated(machine: Machine, handed: Service) -> Iterator[Service]:
    """`twind-sim`."""
    service = Service(machine, SIMULATION, "/run/twind/sim")
    service.until(ActiveState="active")
    yield service
    service.stop()


def test_the_simulation_moves_without_devices_network_or_rights(simulated: Service) -> None:
    main = simulated.main()
    assert "libmujoco" in Path(f"/proc/{main}/maps").read_text()
    names = Path(f"/proc/{main}/net/dev").read_text().splitlines()[2:]
    assert [line.split(":")[0].strip() for line in names] == ["lo"]
    own = [Path(f"/proc/{pid}/ns/net").readlink() for pid in (main, simulated.machine.init)]
    assert own[0] != own[1]
    there = {path.name for path in (own_root(main) / "dev").iterdir()}
    assert not {name for name in there if name.startswith("tty") and name != "tty"}
    with simulated.client() as client:
        path = {"joint_names": ["head_yaw"], "points": [{"positions": [0.3], "time_from_start": 0.4}]}
        assert go(client, path)["phase"] == "succeeded"


def test_a_symbolic_link_in_the_socket_folder_does_not_redirect_root(machine: Machine) -> None:
    """/run/twind is the daemon's: what root would do there, its user could lead to any folder."""
    machine.inside("/run/victim").mkdir(mode=0o700)
    machine.run("ln", "-s", "/run/victim", "/run/twind/led", user="twind")
    for name in ("control", "observe"):
        assert machine.try_run("systemctl", "start", f"twind-{name}@led.socket").returncode != 0
    assert machine.run("stat", "-c", "%a %U %G", "/run/victim").split() == ["700", "root", "root"]
    assert not list(machine.inside("/run/victim").iterdir())


@pytest.mark.parametrize("name", ["sim", "twind"])
def test_an_instance_that_would_share_another_unit_s_files_is_refused(machine: Machine, name: str) -> None:
    assert "masked" in machine.try_run("systemctl", "start", f"twind@{name}.service").stderr
    assert machine.try_run("systemctl", "start", f"twind-control@{name}.socket").returncode != 0


def test_settings_that_cannot_be_used_end_it_with_their_place_and_no_second_try(machine: Machine) -> None:
    file = settings(machine, "wrong", "mode: mirror\nrobbot: h24\n")
    service = Service(machine, "twind@wrong.service")
    with pytest.raises(Failed):
        service.start()
    assert (service.show("ActiveState"), service.show("ExecMainStatus")) == ("failed", "2")
    assert service.show("NRestarts") == "0"
    told = [line["MESSAGE"] for line in service.journal("-p", "err")]
    assert any("/etc/twind/wrong.yaml:2:1" in line and "robot" in line for line in told), service.journal()
    file.unlink()
