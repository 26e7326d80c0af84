"""`twindctl` from outside: what it prints, what it exits with, what it imports."""

import io
import json
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from twind import link
from twind.ctl.ctl_main import main

CTL = [sys.executable, "-m", "twind.ctl.ctl_main"]
LEASE = {"holder": "uid 0, pid 1", "uid": 0, "expires_in": 1.0}


@pytest.fixture(autouse=True)
def _lease(loop: StandIn) -> None:
    """Each client gets the lease."""
    loop.answers[link.AcquireLease] = lambda c: [link.Reply(ticket=c.ticket, parameters={"lease": LEASE})]


def ctl(loop: StandIn, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command line in this process."""
    words = ["--socket", str(loop.directory), *arguments]
    out = io.StringIO()
    err = io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code: Any = main(words)
        except SystemExit as end:
            code = end.code
    return subprocess.CompletedProcess(words, code or 0, out.getvalue(), err.getvalue())


def asked(loop: StandIn) -> list[str]:
    """Commands that came, in order."""
    return [type(command).__name__ for command in loop.commands if isinstance(command, link.Command)]


def phases(*names: str, **last: Any) -> Any:
    """An answer to Submit: these phases, the last of them final."""

    def answer(command: link.Command) -> list[link.Reply]:
        replies = []
        for place, name in enumerate(names):
            parameters: dict[str, Any] = {
                "id": "x",
                "phase": name,
                "progress": place / max(1, len(names) - 1),
            }
            final = place == len(names) - 1
            parameters |= last if final else {}
            replies.append(link.Reply(ticket=command.ticket, parameters=parameters, continues=not final))
        return replies

    return answer


@pytest.mark.parametrize("verb", ["status", "mode", "arm", "estop", "stop", "disarm", "reset"])
def test_a_short_verb_imports_the_standard_library_alone(loop: StandIn, verb: str) -> None:
    loop.answers[link.Arm] = lambda c: [link.Reply(ticket=c.ticket, parameters={"joints": [0, 1]})]
    for kind in (link.Disarm, link.Reset, link.Cancel):
        loop.answers[kind] = lambda c: [link.Reply(ticket=c.ticket, parameters={"state": "connected"})]
    loop.answers[link.EStop] = lambda c: [
        link.Reply(ticket=c.ticket, parameters={"state": "estop", "torque_off": True, "done": True})
    ]
    code = (
        "import sys; from twind.ctl.ctl_main import main\n"
        f"status = main(['--socket', {str(loop.directory)!r}, {verb!r}])\n"
        "heavy = {'numpy', 'asyncio', 'msgspec', 'yaml', 'mujoco', 'importlib.metadata'}\n"
        "print('heavy', sorted(heavy & set(sys.modules)), status)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=20.0)
    assert done.stdout.splitlines()[-1] == "heavy [] 0", done.stderr


def test_status_prints_text_and_with_json_a_json_object(loop: StandIn) -> None:
    done = ctl(loop, "status", "--joints")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[0] == "stand-in · mode live · state armed · motion holding"
    assert any(line.startswith("fault    STATE_STALE: joint_3") for line in lines)
    assert sum(line.startswith("joint_") for line in lines) == len(NAMES)
    assert "silent" in lines[-1]
    answer = json.loads(ctl(loop, "--json", "status").stdout)
    assert answer["status"]["mode"] == "live"
    assert answer == json.loads(ctl(loop, "status", "--json").stdout) | {"status": answer["status"]}


def test_a_monitor_that_is_no_terminal_prints_tables_and_json(loop: StandIn) -> None:
    done = ctl(loop, "monitor", "--rate", "50", "--count", "2")
    assert done.returncode == 0
    assert done.stdout.count("joint_0 ") == 2
    assert "\x1b" not in done.stdout
    lines = ctl(loop, "--json", "monitor", "--count", "3", "--rate", "50").stdout.splitlines()
    assert [json.loads(line)["topic"] for line in lines] == ["state"] * 3


def test_move_takes_the_lease_follows_and_gives_it_back(loop: StandIn) -> None:
    loop.answers[link.Submit] = phases("accepted", "running", "succeeded")
    done = ctl(loop, "move", "joint_1=0.5", "joint_0=-0.25", "--time", "1.5")
    assert (done.returncode, done.stdout) == (0, "succeeded at 100%\n"), done.stderr
    assert list(dict.fromkeys(asked(loop))) == ["AcquireLease", "RenewLease", "Submit", "ReleaseLease"]
    command = loop.await_command(link.Submit)
    assert isinstance(command, link.Submit)
    path = link.unpack_path(loop.paths[-1], command, len(NAMES))
    assert (path.time[0], path.position[0, 0], path.position[0, 1]) == (1.5, -0.25, 0.5)
    assert path.velocity is not None  # ends at rest


def test_without_a_time_a_long_way_takes_longer(loop: StandIn) -> None:
    loop.answers[link.Submit] = phases("succeeded")
    assert ctl(loop, "move", "joint_1=-1.9").returncode == 0
    command = loop.await_command(link.Submit)
    assert isinstance(command, link.Submit)
    assert link.unpack_path(loop.paths[-1], command, len(NAMES)).time[0] == pytest.approx(4.0)


def test_a_refusal_prints_joint_point_value_and_bound(loop: StandIn) -> None:
    finding = {"code": "POS_LIMIT", "joint": 1, "point": 0, "time": 1.0, "value": 3.0, "bound": 1.0}
    loop.answers[link.Submit] = lambda c: [
        link.Reply(ticket=c.ticket, error="Refused", parameters={"findings": [finding]})
    ]
    done = ctl(loop, "move", "joint_1=3")
    assert done.returncode == 1
    assert done.stderr == "twindctl: POS_LIMIT: joint_1, point 0 (1 s): position 3 rad, bound 1 rad\n"
    assert asked(loop)[-1] == "ReleaseLease"
    said = json.loads(ctl(loop, "--json", "move", "joint_1=3").stdout)
    assert said["parameters"]["findings"][0]["joint"] == "joint_1"


def test_a_motion_that_is_aborted_is_no_success(loop: StandIn) -> None:
    finding = {"code": "PATH_TOLERANCE", "joint": 2, "value": 0.3, "bound": 0.1}
    loop.answers[link.Submit] = phases("accepted", "aborted", findings=[finding])
    done = ctl(loop, "move", "joint_1=0.5")
    assert done.returncode == 1
    assert "PATH_TOLERANCE: joint_2" in done.stderr


def test_ctrl_c_cancels_and_reports_how_it_ended(loop: StandIn, tmp_path: Path) -> None:
    running: list[int] = []

    def submit(command: link.Command) -> list[link.Reply]:
        running.append(command.ticket)
        return [
            link.Reply(
                ticket=command.ticket,
                parameters={"id": "x", "phase": "accepted", "progress": 0.0},
                continues=True,
            )
        ]

    def cancel(command: link.Command) -> list[link.Reply]:
        last = {"id": "x", "phase": "cancelled", "progress": 0.5}
        return [
            link.Reply(ticket=running[-1], parameters=last),
            link.Reply(ticket=command.ticket, parameters={"state": "armed"}),
        ]

    loop.answers |= {link.Submit: submit, link.Cancel: cancel}
    command = [*CTL, "--socket", str(loop.directory), "move", "joint_1=0.5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        loop.await_command(link.Submit)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10.0)
    assert (process.returncode, out) == (130, "cancelled at 50%; now at joint_1 0.100 rad\n")
    assert "the robot holds" in err
    assert asked(loop)[-2:] == ["Cancel", "ReleaseLease"]


def test_play_finds_a_built_in_motion_and_names_them_otherwise(loop: StandIn) -> None:
    done = ctl(loop, "play", "wave")
    assert done.returncode == 1  # the stand-in has no such joints: refused, and by the front
    assert "UNKNOWN_JOINT" in done.stderr
    done = ctl(loop, "play", "nosuch")
    assert done.returncode == 2
    assert "wave" in done.stderr


def test_check_prints_a_verdict(loop: StandIn, tmp_path: Path) -> None:
    warning = {"code": "LATENCY_WARN", "value": 0.06, "bound": 0.05}
    verdict = {"refusals": [], "warnings": [warning], "changes": []}
    loop.answers[link.Submit] = lambda c: [link.Reply(ticket=c.ticket, parameters={"verdict": verdict})]
    path = tmp_path / "path.json"
    point = {"positions": [0.1], "time_from_start": {"sec": 1, "nanosec": 500000000}, "velocities": []}
    path.write_text(json.dumps({"header": {}, "joint_names": ["joint_1"], "points": [point]}))
    done = ctl(loop, "check", "trajectory", str(path))
    assert (done.returncode, done.stdout) == (0, "warning  LATENCY_WARN: value 0.06, bound 0.05\naccepted\n")
    command = loop.await_command(link.Submit)
    assert isinstance(command, link.Submit)
    assert command.check_only
    assert link.unpack_path(loop.paths[-1], command, len(NAMES)).time[0] == 1.5


def test_registers_are_read_and_written(loop: StandIn) -> None:
    register = {"name": "goal_position", "address": 116, "size": 4, "value": -5}
    for kind in (link.ReadRegister, link.WriteRegister):
        loop.answers[kind] = lambda c: [link.Reply(ticket=c.ticket, parameters={"register": register})]
    done = ctl(loop, "register", "read", "main", "3", "goal_position")
    assert done.stdout == "goal_position = -5 (address 116, 4 bytes)\n"
    assert ctl(loop, "register", "write", "main", "3", "goal_position", "--", "-5").returncode == 0
    written = loop.await_command(link.WriteRegister)
    assert isinstance(written, link.WriteRegister)
    assert (written.bus, written.id, written.name, written.value) == ("main", 3, "goal_position", -5)


def test_a_scan_lists_what_is_found(loop: StandIn) -> None:
    loop.answers[link.Scan] = lambda c: [
        link.Reply(
            ticket=c.ticket,
            parameters={"bus": "main", "id": n, "model": 1020, "firmware": 47},
            continues=n < 2,
        )
        for n in (1, 2)
    ]
    done = ctl(loop, "scan")
    assert done.stdout.splitlines() == [f"main  id   {n}  model 1020  firmware 47" for n in (1, 2)]


def test_watch_prints_events(loop: StandIn) -> None:
    command = [*CTL, "--socket", str(loop.directory), "watch", "--count", "1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for sequence in range(100):
            if process.poll() is not None:
                break
            loop.send(link.Event(time=1.0, sequence=sequence, level="info", code="TEST", message="hello"))
            time.sleep(0.02)
        out, _ = process.communicate(timeout=5.0)
    assert out == "1.000 info    TEST: hello\n"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "name a verb"),
        (["fly"], "no verb 'fly'"),
        (["move"], "JOINT=RAD"),
        (["move", "knee"], "expected JOINT=RAD"),
        (
            ["move", "knee=45deg"],
            "'knee=45deg': expected JOINT=RAD, a joint and its goal in radians, as knee=0.5",
        ),
        (["move", "knee=nan"], "expected JOINT=RAD"),
        (["move", "a=1", "a=2"], "named twice"),
        (["register", "write", "main", "1", "x"], "write takes a VALUE"),
        (["play", "/nowhere/x.json"], "No such file"),
        (["status", "--fast"], "unrecognized"),
    ],
)
def test_an_invalid_command_line_exits_with_two(loop: StandIn, arguments: list[str], text: str) -> None:
    done = ctl(loop, *arguments)
    assert done.returncode == 2
    assert text in done.stderr
    assert not [name for name in asked(loop) if name != "ReleaseLease" and name != "AcquireLease"]


def test_an_absent_daemon_exits_with_three_and_the_start_command(tmp_path: Path) -> None:
    command = [*CTL, "--socket", str(tmp_path), "status"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0)
    assert done.returncode == 3
    assert "start one with `twind`" in done.stderr
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=20.0)
    assert (done.returncode, json.loads(done.stdout)["error"]) == (3, "NoDaemon")


def test_an_instance_is_named_instead_of_its_folder() -> None:
    command = [*CTL, "-i", "nobody", "status"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0)
    assert done.returncode == 3
    assert "/run/twind/nobody" in done.stderr


def test_a_robot_file_is_checked_without_a_daemon(loop: StandIn, tmp_path: Path) -> None:
    done = ctl(loop, "check", "robot", "h24")
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "ok"), done.stderr
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("format: twind-robot/1\nname: x\nmodle: {}\n")
    done = ctl(loop, "check", "robot", str(wrong))
    assert done.returncode == 1
    assert f"{wrong}:" in done.stderr


def test_a_reboot_reports_restored_and_differing_registers(loop: StandIn) -> None:
    parameters = {
        "state": "connected",
        "restored": ["Position P Gain = 640"],
        "differing": ["LED is 0, was 1"],
    }
    loop.answers[link.Reboot] = lambda c: [link.Reply(ticket=c.ticket, parameters=parameters)]
    done = ctl(loop, "reboot", "main", "7")
    assert (done.returncode, done.stdout.splitlines()) == (
        0,
        [
            "main id 7 restarted: state connected",
            "  restored: Position P Gain = 640",
            "  differs: LED is 0, was 1",
        ],
    )
    assert json.loads(ctl(loop, "--json", "reboot", "main", "7").stdout) == parameters
    loop.answers[link.Reboot] = lambda c: [link.Reply(ticket=c.ticket, parameters={"state": "connected"})]
    assert ctl(loop, "reboot", "main", "7").stdout == "main id 7 restarted: state connected\n"
