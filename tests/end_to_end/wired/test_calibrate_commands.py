"""`twindctl calibrate` as a person uses it: real processes, hands, a file that makes the robot go."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.calibration_bench import ROBOT, Bench, Captured, Words, benched, json_lines
from tests.support.processes import arm, go, until
from twind.client import ClientError
from twind.config.calibration_file import load_calibration
from twind.ctl.ctl_main import main

WELL = 3  # ticks


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with benched("--truth-seed", "11") as made:
        yield made


def test_an_unknown_joint_is_refused_before_any_calibration_step(bench: Bench, capsys: Captured) -> None:
    for step in ("zero", "limits", "endstop --side lower", "prove --base back"):  # and nobody to ask
        assert bench.verb(*step.split(), "l_kne") == 1
        assert "h24 has no joint 'l_kne'; nearest: l_knee" in capsys.readouterr().err
        assert bench.verb(*step.split(), "l_knee") == 2
        assert "standard input is no terminal; add --yes" in capsys.readouterr().err
    assert bench.verb("zero") == 2
    assert bench.verb("zero", "--yes", "--json") == 1
    assert bench.verb("sweep", "l_kne") == 1
    assert bench.verb("limits", "--yes") == 1
    assert "mode live alone" in capsys.readouterr().err
    assert main(["--socket", str(bench.state), "calibrate", "sweep"]) == 3  # no daemon there
    assert not list(bench.state.glob("**/*.yaml"))


def test_a_joint_moved_in_place_of_the_requested_one_is_reported_and_not_kept(
    bench: Bench, capsys: Captured
) -> None:
    refused: list[str] = []

    def move() -> None:
        bench.hands("upper", ["r_knee"])
        until(lambda: bench.daemon.status()["state"] == "calibrating", 5.0, "nobody arms")
        with bench.daemon.client() as client, pytest.raises(ClientError) as other:
            client.call("SetMode", mode="live")  # somebody else, who would arm
        refused.append(str(other.value))

    mover = threading.Timer(0.3, move)
    mover.start()
    assert bench.verb("sweep", "l_knee", "--timeout", "2") == 1
    mover.join()
    assert "end the calibration first" in refused[0] or "LEASE" in refused[0]
    said = capsys.readouterr().out
    assert "r_knee moved while l_knee, asked for, did not: are their ids swapped" in said
    assert "not done: l_knee: it was not moved" in said and "0 of 1 swept" in said


def test_a_robot_is_calibrated_by_sweep_zero_and_limits_and_then_moves(
    bench: Bench, capsys: Captured
) -> None:
    before = {entry.name: entry for entry in load_calibration(bench.virtual.calibration, ROBOT).joints}

    # Some first, then the rest: what is done stays done.
    bench.hands(None)
    bench.there()
    legs = [joint.name for joint in ROBOT.joints if joint.name in ROBOT.legs]
    for names, left in ((legs, "--json"), (None, "--json")):
        capsys.readouterr()
        with _moving(bench, names):
            assert bench.verb("sweep", left, *(names or []), "--timeout", "60") == 0, capsys.readouterr().out
        *events, last = json_lines(capsys.readouterr().out)
        done = [event["joint"] for event in events if event["event"] == "done"]
        assert sorted(done) == sorted(last["done"])
        assert set(done) == set(names or ROBOT.names) - (set() if names else set(legs))
        assert any(event["event"] == "moving" and 0.0 < event["share"] < 1.3 for event in events)
        assert last["left"] == {} and Path(last["draft"]).name == ".h24.draft.yaml"
        assert last["next"].endswith("calibrate zero")

    bench.hands(None)
    bench.there()
    assert bench.verb("zero", "l_knee", "--at", "l_knee=1.4", "--yes") == 1  # it does not stand there
    assert not bench.file.exists()
    assert bench.verb("zero", "--yes") == 0
    said = capsys.readouterr().out
    assert f"written: {bench.file}, 24 of 24 joints" in said and "systemctl restart twind" in said
    assert not list(bench.state.glob("**/.h24.draft.yaml"))

    made = load_calibration(bench.file, ROBOT)
    for joint in made.joints:
        apart = (joint.zero_ticks - before[joint.name].zero_ticks + 2048) % 4096 - 2048
        assert abs(apart) <= WELL, (joint.name, apart)
        assert joint.method == "jig" and joint.captures == 50 and joint.device == before[joint.name].device

    bench.let_go()
    bench.power_cycle()  # some were turns off, where position mode has no torque
    bench.restart("live")
    with bench.daemon.client() as client:
        arm(client)
        assert bench.verb("sweep", "l_knee") == 1
        assert "torque is on" in capsys.readouterr().err
        point = {"positions": [0.4], "velocities": [0.0], "time_from_start": 1.0}
        assert go(client, {"joint_names": ["l_knee"], "points": [point]})["phase"] == "succeeded"
        client.call("Disarm")
    _fence(bench, capsys)


class Slow:
    """A person at a terminal who takes longer than a lease lasts."""

    def __init__(self, *answers: str) -> None:
        self._answers = list(answers)

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        time.sleep(1.3)
        return self._answers.pop(0)


def test_a_slow_operator_does_not_break_a_calibration(
    bench: Bench, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bench.daemon.status()["mode"] == "live", "after the calibration above"
    before = bench.file.read_text()
    monkeypatch.setattr(sys, "stdin", Slow("\n", "n\n"))
    bench.hands(None, ["l_knee"])
    bench.there()
    assert bench.verb("zero", "l_knee") == 1
    said = capsys.readouterr()
    assert "hold the robot in its zero pose (every joint at 0 rad): 1 joints are read" in said.out
    assert "write 1 of 1 joints to" in said.out and "nothing was written" in said.err
    assert bench.file.read_text() == before
    for _ in range(3):  # a reply that a busy machine loses ends it with the command that goes on
        monkeypatch.setattr(sys, "stdin", Slow("y\n"))
        if (code := bench.verb("limits", "waist_yaw")) == 0:
            break
    assert code == 0
    assert "waist_yaw" in capsys.readouterr().out and bench.file.read_text() != before
    bench.restart("live")


def test_calibration_in_live_prevents_arming_and_ctrl_c_keeps_completed_joints(
    bench: Bench, capsys: Captured
) -> None:
    mode = bench.daemon.status()["mode"]
    assert mode == "live", "after the calibration above"
    bench.hands(None, ["head_yaw", "l_knee"])
    bench.there()
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(bench.daemon.sockets)]
    words = ["calibrate", "sweep", "--json", "head_yaw", "l_knee"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background ignore it
    sweeping = subprocess.Popen([*command, *words], stdout=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, before)
    assert sweeping.stdout is not None
    try:
        until(lambda: bench.daemon.status()["state"] == "calibrating", 20.0, "nobody arms")
        with bench.daemon.client() as client, pytest.raises(ClientError):
            arm(client)
        with _moving(bench, ["head_yaw"]):
            while '"done"' not in (line := sweeping.stdout.readline()):
                assert line, "it ended by itself"
        sweeping.send_signal(signal.SIGINT)
        assert sweeping.wait(20.0) == 130
    finally:
        if sweeping.poll() is None:
            sweeping.kill()
        sweeping.wait(10.0)
        sweeping.stdout.close()
    until(lambda: bench.daemon.status()["state"] == "connected", 20.0, "armed by whoever wants")
    draft = bench.file.parent / ".h24.draft.yaml"
    assert "head_yaw" in draft.read_text() and "l_knee" not in draft.read_text()

    measured = load_calibration(bench.file, ROBOT)
    assert bench.verb("zero", "--from-sweep", "--yes") == 0
    said = capsys.readouterr().out
    assert "a zero is coarse" in said and "a wrong sign fits its ends too: `twindctl" in said
    after = load_calibration(bench.file, ROBOT)
    then = measured.by_name["head_yaw"]
    now = after.by_name["head_yaw"]
    assert (now.method, now.captures) == ("sweep", 2) and abs(now.zero_ticks - then.zero_ticks) < 60
    assert after.by_name["l_knee"] == measured.by_name["l_knee"]
    assert bench.verb("zero", "--from-sweep", "--yes") == 1

    with bench.daemon.client() as client:
        client.call("SetMode", mode="sim")
    assert bench.verb("sweep", "l_knee") == 1
    assert "mode sim reads no robot" in capsys.readouterr().err


@contextmanager
def _moving(bench: Bench, names: Words | None) -> Iterator[None]:
    """Hands that go from end to end until nobody asks any more: a machine that is busy may lose a reading."""
    enough = threading.Event()

    def move() -> None:
        enough.wait(0.5)
        while not enough.is_set():
            for side in ("upper", "lower"):
                bench.hands(side, names)
                bench.there()
                enough.wait(0.5)

    mover = threading.Thread(target=move)
    mover.start()
    try:
        yield
    finally:
        enough.set()
        mover.join()


def _fence(bench: Bench, capsys: Captured) -> None:
    """The servos' own limits, recorded: the daemon starts with them and arms."""
    capsys.readouterr()
    assert bench.verb("limits", "--yes", "--json", "l_knee", "head_yaw") == 0, capsys.readouterr()
    *rows, last = json_lines(capsys.readouterr().out)
    assert [row["joint"] for row in rows] == ["head_yaw", "l_knee"] and last["written"] == str(bench.file)
    made = load_calibration(bench.file, ROBOT).by_name["l_knee"]
    servo = next(each for each in bench.virtual.servos() if each["id"] == made.id)
    assert made.device.min_ticks == rows[1]["min_position_limit"]
    assert servo["id"] == 16
    assert bench.verb("limits", "--yes", "l_knee") == 0
    bench.restart("live")
    with bench.daemon.client() as client:
        arm(client)
        client.call("Disarm")
    assert len(list(bench.file.parent.glob("h24.*.yaml"))) == 1  # the earlier one is kept
