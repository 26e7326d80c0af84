"""Real-time tests of docs."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tests.support import rclpy_environment as ros_peer
from tests.support.dds_domain import free_domain
from tests.support.doc_pages_text import README, ROOT, fenced
from tests.support.docs_rig import readme_lines, run, wait_for
from tests.support.processes import until
from tests.support.zenoh_router import free_port

BIN = Path(sys.executable).parent
# What a test cannot run as it stands, and why.
NEEDS = {
    "make": "runs the tests themselves; checked to be a target",
    "sudo": "root",
    ".": "the environment of the clone; the tests run in theirs",
    "export": "goes with the lines behind it",
    "twind": "a real robot; its options are checked",
}


@contextmanager
def daemon(runtime: Path, *options: str) -> Iterator[dict[str, str]]:
    """A daemon where the examples look for one; the environment in which they find it."""
    environment = {
        **os.environ,
        "XDG_RUNTIME_DIR": str(runtime),
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
    }
    command = [sys.executable, "-m", "twind.cli", *options, "--socket", str(runtime / "twind")]
    with (runtime / "log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log, stdin=subprocess.DEVNULL, env=environment)
    try:
        yield environment
        process.terminate()
        assert process.wait(20.0) == 0, (runtime / "log").read_text()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(10.0)


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """Runtime folder and environment of a simulated daemon."""
    runtime = tmp_path_factory.mktemp("simulation")
    state = {"STATE_DIRECTORY": str(runtime / "state"), "XDG_STATE_HOME": str(runtime)}
    with pytest.MonkeyPatch.context() as patch:
        for key, value in state.items():
            patch.setenv(key, value)
        with daemon(runtime, "--mode", "sim") as environment:
            wait_for(runtime, mode="sim")
            yield runtime, environment


def commands_of(heading: str) -> list[str]:
    """Commands in the section of the README with this heading."""
    section = README.partition(f"## {heading}")[2].partition("\n## ")[0]
    return [line for block in fenced(section, "sh") for line in block.splitlines()]


def test_the_read_only_commands_of_the_readme_work(simulation: tuple[Path, dict[str, str]]) -> None:
    lines = {line.split()[1]: line for line in commands_of("Observe")}
    assert list(lines) == ["monitor", "view", "record", "mark", "metrics", "dump", "replay", "plot"]
    folder, environment = simulation
    goes_on = ["monitor", "record"] + (["view"] if find_spec("mjviser") else [])
    going = {verb: begin(lines[verb], folder, environment) for verb in goes_on}
    until(lambda: len(list(folder.rglob("*.mcap"))) == 1, 20.0, "no recording was begun")
    for verb in ("mark", "metrics"):
        assert run(lines[verb], folder, environment)
    dumped = Path(run(f'{lines["dump"]}\necho "$F"', folder, environment).strip())
    time.sleep(1.0)
    told = {verb: ended(process) for verb, process in going.items()}
    assert "h24" in told["monitor"] and "nothing dropped" in told["record"]
    assert "http://127.0.0.1:" in told.get("view", "http://127.0.0.1:")
    there = environment | {"F": str(dumped)}
    assert "the same" in run(lines["replay"], folder, there)
    if find_spec("matplotlib"):
        run(lines["plot"], folder, there)
        assert dumped.with_name(f"{dumped.name}.png").read_bytes().startswith(b"\x89PNG")


def begin(line: str, folder: Path, environment: dict[str, str]) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        ["bash", "-c", f"exec {line}"],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ended(process: "subprocess.Popen[str]") -> str:
    """Output of the program after SIGINT, as by Ctrl-C."""
    process.send_signal(signal.SIGINT)
    return process.communicate(timeout=20.0)[0]


def test_the_ros_and_remote_commands_of_the_readme_work(simulation: tuple[Path, dict[str, str]]) -> None:
    lines = commands_of("Connect")
    ros, uplink, fleet, move = [line for line in lines if line.startswith("twindctl ")]
    assert {line.split()[0] for line in lines} == {"export", "twindctl"}
    pytest.importorskip("zenoh", reason="the extra `ros` is not installed")
    port = free_port()
    assert "tcp/0.0.0.0:7448" in uplink and "export TWIND_ZENOH=tcp/ROBOT:7448" in "\n".join(lines)
    uplink = uplink.replace("0.0.0.0:7448", f"127.0.0.1:{port}")
    folder, environment = simulation
    with free_domain() as domain:
        graph = ros_peer.environment(folder, domain) | environment
        going = [begin(ros, folder, graph), begin(uplink, folder, environment)]
        desk = environment | {"TWIND_ZENOH": f"tcp/127.0.0.1:{port}"}

        def listed() -> bool:
            told = subprocess.run(["bash", "-c", fleet], cwd=folder, env=desk, capture_output=True, text=True)
            return told.returncode == 0 and told.stdout.count("h24") == 2

        until(listed, 30.0, "not both here and elsewhere")
        run(move, folder, desk)
        said = [ended(process) for process in going]
    assert "domain" in said[0] and "h24 is up" in said[1], said


def test_the_readme_commands_work_on_a_virtual_robot(tmp_path: Path) -> None:
    left = [line for line in readme_lines() if line.split()[0] not in NEEDS]
    # They need no daemon, ask a person, or take minutes and have tests of their own here.
    apart = ("check", "scan", "calibrate", "wiggle", "teleop", "gap", "identify", "tune")
    verbs = [line for line in left if line.startswith("twindctl ") and line.split()[1] not in apart]
    apart_sections = [line for heading in ("Observe", "Learn", "Connect") for line in commands_of(heading)]
    verbs = [line for line in verbs if line not in apart_sections]
    assert [line.split()[1] for line in verbs] == [
        "status",
        "arm",
        "move",
        "play",
        "estop",
        "reset",
        "disarm",
    ]
    with daemon(tmp_path, "--virtual", "--mode", "live") as environment:
        wait_for(tmp_path, state="connected")
        for line in verbs:
            verb = line.split()[1]
            if verb == "play":  # long: what comes next, the e-stop, ends it
                playing = subprocess.Popen(["bash", "-c", f"exec {line}"], cwd=tmp_path, env=environment)
                wait_for(tmp_path, motion="active")
                continue
            if verb == "reset":  # it says: once torque is off
                assert playing.wait(10.0) == 1
                wait_for(tmp_path, armed=False)
            run(line, tmp_path, environment)
        wait_for(tmp_path, state="connected", armed=False)


def test_the_other_commands_of_the_readme_run_as_printed(tmp_path: Path) -> None:
    scan, check = [line for line in readme_lines() if line.split()[1] in ("scan", "check")]
    (doctor,) = re.findall(r"`(twindctl doctor [^`]+)`", README)
    servos = fenced((ROOT / "docs" / "virtual.md").read_text(), "sh")[0].splitlines()[0]
    robots = Path(str(resources.files("twind.robots")))
    shutil.copy(robots / "h24.yaml", tmp_path / "my_robot.yaml")
    shutil.copy(robots / "h24.xml", tmp_path)
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    assert run(check, tmp_path, environment).endswith("ok\n")
    assert "/tmp/" in servos
    process = subprocess.Popen(
        ["bash", "-c", "exec " + servos.replace("/tmp/", f"{tmp_path}/")],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    assert process.stdout.readline().startswith("bus main ")
    assert process.stdout.readline() == "ready\n"
    assert (tmp_path / "robot" / "main").exists() and (tmp_path / "robot-faults").is_socket()
    found = run(scan.replace("/dev/ttyUSB0", f"{tmp_path}/robot/main"), tmp_path, environment)
    assert found.count("XM430-W350") == 24 and "2000000" in found.replace(",", "").replace("_", "")
    diagnosed = subprocess.run(
        ["bash", "-c", doctor.replace("/dev/ttyUSB0", f"{tmp_path}/robot/main")],
        cwd=tmp_path,
        env=environment | {"XDG_STATE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert diagnosed.returncode == 1, diagnosed.stderr  # this robot has no calibration yet
    last = diagnosed.stdout.splitlines()[-1]
    assert "CALIBRATION_MISSING" in diagnosed.stdout
    assert "; looked at " in last and "servos" not in last, "nothing but what could not be seen is named"
    process.stdin.close()
    assert process.wait(10.0) == 0
    process.stdout.close()


def test_the_python_example_of_the_readme_moves_the_simulation(
    simulation: tuple[Path, dict[str, str]],
) -> None:
    (example,) = fenced(README, "python")
    folder, environment = simulation
    (folder / "example.py").write_text(example)
    before = json.loads(run("twindctl --json status", folder, environment))["status"]["loop"]["ticks"]
    said = run(f"{shlex.quote(sys.executable)} example.py", folder, environment).splitlines()
    after = json.loads(run("twindctl --json status", folder, environment))["status"]["loop"]["ticks"]
    assert said[-1].startswith("JointReading(name='head_yaw', position=")
    assert after - before > 500  # a move of 1 s and a wave of 9 s were waited for


def test_the_python_example_of_the_readme_runs_in_a_notebook_and_the_robot_is_a_table(
    simulation: tuple[Path, dict[str, str]],
) -> None:
    for needed in ("nbclient", "ipykernel"):
        pytest.importorskip(needed, reason="make extras EXTRAS=notebook")
    (example,) = fenced(README, "python")
    folder, environment = simulation
    cells = [example, "robot = Robot(read_only=True)\nrobot", "robot.state", "robot.close()"]
    pages = execute_cells(cells, folder, environment)
    (printed,) = pages[0]
    assert printed["text"].startswith("JointReading(name='head_yaw', position=")
    for (shown,) in pages[1:3]:
        table = shown["data"]["text/html"]
        assert table.startswith("<table><tr><th>joint</th>") and "<td>head_yaw</td>" in table
        assert table.count("<tr>") == 25  # a head and the joints of h24


def execute_cells(cells: list[str], folder: Path, environment: dict[str, str]) -> list[list[Any]]:
    """Run cells in a new kernel of Jupyter; return the outputs of each."""
    import nbclient
    import nbformat

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(each) for each in cells])
    resources = {"metadata": {"path": str(folder)}}
    client = nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3", resources=resources)
    client.execute(env=environment)
    return [cell["outputs"] for cell in notebook.cells]


def test_the_setpoint_example_of_the_protocol_page_moves_the_simulation(
    simulation: tuple[Path, dict[str, str]],
) -> None:
    section = (ROOT / "docs" / "protocol.md").read_text().partition("### Setpoints")[2]
    example = fenced(section, "python")[0]
    folder, environment = simulation
    (folder / "setpoints.py").write_text(example)
    run(f"{shlex.quote(sys.executable)} setpoints.py", folder, environment)
    status = json.loads(run("twindctl --json status --joints", folder, environment))
    (head,) = [joint for joint in status["joints"] if joint["name"] == "head_yaw"]
    assert abs(head["goal"] - 0.597) < 0.05  # 0.3 - 0.3 cos 3, where the motion decelerates


@pytest.mark.parametrize("place", [0, 1, 2, 3, 5])
def test_the_examples_of_the_python_page_run_in_the_simulation(
    simulation: tuple[Path, dict[str, str]], place: int
) -> None:
    """All but that of two robots and that of the walk; in mode sim `arm` is left out, as the page says."""
    example = fenced((ROOT / "docs" / "python.md").read_text(), "python")[place]
    example = re.sub(r"^    robot\.arm\(\).*\n", "", example, flags=re.MULTILINE).replace("t > 10", "t > 1")
    if not example.startswith(("from", "import")):  # it uses the robot of the example before it
        example = f"from twind import Robot\n\nwith Robot() as robot:\n    {example}"
    folder, environment = simulation
    (folder / "page.py").write_text(example)
    output = run(f"{shlex.quote(sys.executable)} page.py", folder, environment)
    assert "Refused" not in output


def test_the_order_program_of_the_virtual_page_pushes_a_virtual_robot(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "virtual.md").read_text()
    (program,) = (each for each in fenced(page, "python") if "sys.argv" in each)
    order = next(line for line in page.splitlines() if line.startswith("python order.py"))
    (tmp_path / "order.py").write_text(program)
    with (
        subprocess.Popen(
            [BIN / "twind-virtual", "--robot", "h24-standing", "--faults", str(tmp_path / "PATH")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as virtual,
    ):
        assert virtual.stdout is not None and virtual.stdin is not None
        while virtual.stdout.readline() not in ("ready\n", ""):
            pass
        command = order.replace("python", shlex.quote(sys.executable), 1)
        assert json.loads(run(command, tmp_path, {**os.environ})) == {"ok": True}
        virtual.stdin.close()
        assert virtual.wait(20.0) == 0
