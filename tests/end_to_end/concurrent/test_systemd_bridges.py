"""The bridges as services: who is outside hears them, and they own nothing and command nothing until told."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.certificates import Authority
from tests.support.systemd.installed import OPT, PEERS, REPOSITORY
from tests.support.systemd.machine import Machine, stop
from tests.support.systemd.service import DYNAMIC_USER, Service, Unit, drop_in, unprivileged_user

PYTHON = "/opt/twind/bin/python"
SIM = "twind-sim.service"  # its bridges are those of the instance `sim`
DOMAIN = "41"


@pytest.fixture(scope="module")
def simulated(machine: Machine) -> Iterator[Service]:
    """A simulated robot as a service."""
    pytest.importorskip("zenoh", reason="no eclipse-zenoh here")
    service = Service(machine, SIM, "/run/twind/sim").start()
    yield service
    service.stop()


@pytest.fixture(scope="module")
def uplink(simulated: Service) -> Iterator[Unit]:
    """Its uplink, and the router that the uplink looks for."""
    machine = simulated.machine
    router = machine.popen(PYTHON, f"{PEERS}/support/zenoh_router.py", "tcp/127.0.0.1:7447")
    unit = Unit(machine, "twind-uplink@sim.service").start()
    yield unit
    unit.stop()
    stop(router)


def afar(unit: Unit, *words: str) -> tuple[int, str]:
    """Exit code and output of `twindctl --remote` for the robot of this uplink."""
    done = unit.machine.try_run("twindctl", "--remote", "h24", *words)
    return done.returncode, done.stdout + done.stderr


def test_the_uplink_is_seen_from_afar_and_commands_nothing(uplink: Unit) -> None:
    uplink.machine.until(lambda: afar(uplink, "status")[0] == 0, 20.0, "the robot from afar")
    assert "sim" in afar(uplink, "status")[1]
    code, said = afar(uplink, "move", "head_yaw=0.2")
    assert code != 0
    assert "control.sock" in said


def test_a_drop_in_gives_the_uplink_the_right_to_take_goals(uplink: Unit) -> None:
    drop_in(uplink.machine, "twind-uplink@.service", "uplink-commands.conf")
    uplink.machine.run("systemctl", "restart", uplink.unit)
    # Again, for a machine that is too busy holds the robot on its way.
    uplink.machine.until(lambda: afar(uplink, "move", "head_yaw=0.2")[0] == 0, 40.0, "a motion from afar")


def test_a_ros_peer_receives_the_joints(simulated: Service) -> None:
    pytest.importorskip("cyclonedds", reason="no cyclonedds here")
    machine = simulated.machine
    machine.inside("/etc/twind/ros-sim.env").write_text(f"ROS_DOMAIN_ID={DOMAIN}\nOPTIONS=--backend dds\n")
    unit = Unit(machine, "twind-ros@sim.service").start()
    peer = machine.popen(
        *("env", f"CYCLONEDDS_URI={config()}", f"PYTHONPATH={OPT}"),
        *(PYTHON, "-m", "tests.support.ros_dds_peer", DOMAIN),
    )
    assert peer.stdin is not None and peer.stdout is not None
    try:

        def asked(do: str, **more: str) -> Any:
            peer.stdin.write(json.dumps({"do": do, "topic": "/joint_states", **more}).encode() + b"\n")
            peer.stdin.flush()
            return json.loads(peer.stdout.readline())["answer"]

        asked("listen", kind="JointState")
        heard = machine.until(lambda: asked("received"), 20.0, "joint states")
        assert "head_yaw" in heard[0]["name"]
        harmless(unit)
    finally:
        stop(peer)
        unit.stop()
    assert unit.show("Result") == "success"


def test_the_uplink_owns_nothing(uplink: Unit) -> None:
    harmless(uplink)


def test_an_uplink_proves_by_its_credentials_who_it_is(uplink: Unit, tmp_path: Path) -> None:
    """The examples of router, drop-in and configuration together, for an instance; the last of its tests."""
    machine = uplink.machine
    name = "h24-007"
    endpoint = "tls/localhost:7448"
    authority = Authority(tmp_path / "authority")
    for who in ("router", name, "operator"):
        folder = machine.inside(f"/etc/twind/{who}")
        folder.mkdir()
        for part, path in zip(
            ("cert", "key", "ca"), (*authority.sign(who), authority.certificate), strict=True
        ):
            (folder / f"{part}.pem").write_bytes(path.read_bytes())
    said = example("zenoh-router.json5").replace("/etc/zenoh/", "/etc/twind/router/")
    machine.inside("/etc/twind/router.json5").write_text(said)
    own = example("uplink.json5").replace("twind-uplink.service", uplink.unit)
    machine.inside("/etc/twind/uplink-sim.json5").write_text(own)
    theirs = own.replace(f"/run/credentials/{uplink.unit}/", "/etc/twind/operator/")
    theirs = theirs.replace('mode: "client",', f'mode: "client", connect: {{endpoints: ["{endpoint}"]}},')
    machine.inside("/etc/twind/operator.json5").write_text(theirs)
    machine.inside("/etc/twind/uplink-sim.env").write_text(
        f"CONNECT={endpoint}\nOPTIONS=--zenoh-config /etc/twind/uplink-sim.json5 --name {name}\n"
    )
    drop_in(machine, uplink.unit, "uplink-elsewhere.conf")
    machine.inside("/etc/twind/uplink").symlink_to(name)  # where the drop-in finds them
    address = endpoint.replace("localhost", "127.0.0.1")
    router = machine.popen(PYTHON, f"{PEERS}/support/zenoh_router.py", address, "/etc/twind/router.json5")
    try:
        uplink.machine.run("systemctl", "restart", uplink.unit)
        ask = ("env", "TWIND_ZENOH=/etc/twind/operator.json5", "twindctl", "--remote", name, "status")
        machine.until(lambda: machine.try_run(*ask).returncode == 0, 20.0, "the robot, by its certificate")
        assert "sim" in machine.run(*ask)
    finally:
        stop(router)


def example(name: str) -> str:
    """A file of the repository's examples."""
    return (REPOSITORY / "systemd/examples" / name).read_text()


def harmless(unit: Unit) -> None:
    """A user of its own, no right, no device, and in a network where it hears this machine alone."""
    assert unprivileged_user(unit.main()) >= DYNAMIC_USER
    assert set(unit.show("IPAddressDeny").split()) == {"::/0", "0.0.0.0/0"}


def config() -> str:
    """Cyclone's, as the peer has it elsewhere."""
    from tests.support.ros_dds_peer import CONFIG

    return CONFIG
