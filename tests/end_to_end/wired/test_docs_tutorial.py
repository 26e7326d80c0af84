"""docs/tutorial.md: files are those of docs/examples, tables match the code, commands run in order."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.doc_pages_text import ROOT, fenced, table
from tests.support.docs_rig import wait_for
from tests.support.processes import BUSY, LATCHED

PAGE = ROOT / "docs" / "tutorial.md"
TEXT = PAGE.read_text()
EXAMPLES = ROOT / "docs" / "examples"
BIN = Path(sys.executable).parent
INTERFACE = (ROOT / "twind" / "protocol" / "io.twind.Control.varlink").read_text()


def section(heading: str) -> str:
    """Text of the section with this heading, to the next one of the same level."""
    return TEXT.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def block(heading: str, language: str = "sh", index: int = 0) -> str:
    """One fenced block of a section."""
    return fenced(section(heading), language)[index]


# ------------------------------------------------------------------------------------- files and tables


@pytest.mark.parametrize(
    ("language", "file"), [("yaml", "arm.yaml"), ("xml", "arm.xml"), ("json", "motions/reach.json")]
)
def test_a_file_that_the_page_prints_is_the_example_file(language: str, file: str) -> None:
    printed = [text for text in fenced(TEXT, language) if not text.startswith("format: twind-mapping/")]
    assert printed == [(EXAMPLES / "arm" / file).read_text()]


def test_the_table_of_joint_fields_has_every_field_of_the_interface() -> None:
    rows = table(TEXT, "field", "unit", "meaning")
    documented = [name for row in rows for name in re.findall(r"`(\w+)`", row[0])]
    declared = re.findall(r"^  (\w+):", INTERFACE.partition("\ntype Joint (")[2].partition("\n)")[0], re.M)
    assert documented == declared


def test_the_stiffness_and_damping_of_the_model_follow_the_formulas_of_the_page() -> None:
    assert f"`kv` = 4.1 / 4.82 = {4.1 / 4.82:.2f}" in TEXT
    stiffness = 800 / 128 * 4096 / (2 * np.pi) / 885 * 4.1
    assert f": {stiffness:.0f} for 800." in TEXT
    model = mujoco.MjModel.from_xml_path(str(EXAMPLES / "arm" / "arm.xml"))
    assert model.actuator_gainprm[:, 0] == pytest.approx(round(stiffness))
    assert model.actuator_biasprm[:, 2] == pytest.approx(-0.85)


def speed_after_a_second(xml: str) -> tuple[float, bool]:
    """Largest joint speed (rad/s) one second after a step, and whether the simulation diverged."""
    model = mujoco.MjModel.from_xml_string(xml.replace("<freejoint/>", ""))
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.0, 0.3, -1.0]
    fastest = 0.0
    for step in range(400):
        mujoco.mj_step(model, data)
        if step >= 200:
            fastest = max(fastest, float(np.abs(data.qvel).max()))
    return fastest, data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0


def test_a_model_without_armature_and_damping_oscillates_as_documented(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log here
    whole = (EXAMPLES / "arm" / "arm.xml").read_text()
    bare = re.sub(r' damping="[^"]+" armature="[^"]+" frictionloss="[^"]+"', "", whole)
    assert bare != whole
    assert speed_after_a_second(whole)[0] < 0.01
    speed, diverged = speed_after_a_second(bare)
    assert f"oscillates at {speed:.0f} rad/s after one second" in TEXT and not diverged
    assert speed_after_a_second(bare.replace(' kv="0.85"', ""))[1]


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("arm.xml", ' angle="radian"', ""), ("arm.xml", "", ""), ("arm.yaml", "baud: 1000000", "baud: 57600")],
    ids=["degrees", "no actuator", "slow bus"],
)
def test_a_first_error_has_the_message_of_the_table(file: str, old: str, new: str, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "arm", tmp_path / "arm")
    path = tmp_path / "arm" / file
    text = path.read_text()
    if old:
        assert old in text
        path.write_text(text.replace(old, new))
    else:
        path.write_text(re.sub(r'<position name="elbow".*\n', "", text))
    checked = subprocess.run(
        [BIN / "twindctl", "check", "robot", "arm.yaml"], cwd=tmp_path / "arm", capture_output=True, text=True
    )
    assert checked.returncode != 0
    rows = [row[0].strip("`") for row in table(TEXT, "message contains", "remedy")]
    assert sum(row in checked.stdout + checked.stderr for row in rows) == 1


def test_the_bus_times_and_pairs_of_both_examples_are_those_of_the_table() -> None:
    found = {}
    for name in ("arm", "nine"):
        checked = subprocess.run(
            [BIN / "twindctl", "check", "robot", EXAMPLES / name / f"{name}.yaml"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert checked.stdout.endswith("ok\n")
        fast = re.findall(r"  fast sync read: .* (\d+) us, ", checked.stdout)
        pairs = re.search(r"clearance: (\d+) pairs", checked.stdout)
        assert pairs
        found[name] = ([f"{int(each) / 1000:.1f}" for each in fast], pairs[1])
    rows = {row[0]: row[1:] for row in table(TEXT, "item", "arm", "nine joints")}
    assert re.findall(r"\d\.\d", rows["bus time"][0]) == found["arm"][0]
    assert re.findall(r"\d\.\d", rows["bus time"][1]) == found["nine"][0]
    assert [re.findall(r"\d+", cell)[0] for cell in rows["collisions"]] == [found["arm"][1], found["nine"][1]]


# -------------------------------------------------------------------------------------- commands, in order


def place(command: str, folder: Path) -> str:
    """The command with the page's folder /tmp below the test's own."""
    return command.replace("/tmp/", f"{folder}/")


@contextmanager
def running(command: str, cwd: Path, environment: dict[str, str]) -> "Iterator[subprocess.Popen[str]]":
    """A command of the page that runs until its terminal ends it."""
    log = cwd / f"{shlex.split(command)[0]}.log"
    with log.open("w") as errors:
        process = subprocess.Popen(
            ["bash", "-c", f"exec {command}"],
            cwd=cwd,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
    assert process.stdin and process.stdout
    try:
        yield process
        process.terminate()
        assert process.wait(30.0) in (0, -15), log.read_text()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(10.0)
        process.stdin.close()
        process.stdout.close()


TRIES = 8  # a busy machine delays answers of the virtual servos; the daemon then refuses or holds


def run(script: str, cwd: Path, environment: dict[str, str]) -> str:
    """Output of a block of commands; repeated where the machine was too busy, and after what that left."""
    busy = BUSY | {"no reply to read"}  # a late answer while arming: ARM_FAILED
    passing = busy
    for _ in range(TRIES):
        (cwd / "reach.mcap").unlink(missing_ok=True)
        done = subprocess.run(
            ["bash", "-e", "-c", script],
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            timeout=90.0,
        )
        if not any(code in done.stderr for code in passing):
            break
        passing = busy | LATCHED
        time.sleep(1.0)
        recovery = "twindctl disarm; twindctl reset"
        if "twindctl arm" not in script:  # the block begins with an armed robot
            recovery += "; twindctl arm"
        subprocess.run(["bash", "-c", recovery], cwd=cwd, env=environment, capture_output=True, timeout=90.0)
    assert done.returncode == 0, (script, done.stdout, done.stderr)
    return done.stdout


def terminal(home: Path) -> dict[str, str]:
    """The environment of a newcomer's terminal, with sockets and state below the test's folder."""
    runtime = home / "runtime"
    runtime.mkdir()
    return {
        **os.environ,
        "HOME": str(home),
        "XDG_RUNTIME_DIR": str(runtime),
        "STATE_DIRECTORY": str(home / "state"),
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
    }


def copied(heading: str, home: Path, environment: dict[str, str]) -> Path:
    """The folder that the first two lines of the section's block make and enter."""
    copy, enter = block(heading).splitlines()[:2]
    run(copy, ROOT, environment)
    return home / enter.removeprefix("cd ~/")


def run_python(heading: str, folder: Path, environment: dict[str, str]) -> list[str]:
    (folder / "angles.py").write_text(block(heading, "python"))
    return run(f"{shlex.quote(sys.executable)} angles.py", folder, environment).splitlines()


def test_the_arm_of_the_tutorial_is_checked_armed_moved_played_recorded_and_disarmed(tmp_path: Path) -> None:
    environment = terminal(tmp_path)
    arm = copied("1. Copy a minimal robot", tmp_path, environment)
    assert run(block("2. Check the robot"), arm, environment).endswith("ok\n")
    servos = place(block("3. Start virtual servos").strip(), tmp_path)
    daemon = place(block("4. Start the daemon").strip(), tmp_path)
    sockets = tmp_path / "runtime" / "twind"
    with running(servos, arm, environment) as process:
        assert process.stdout
        assert process.stdout.readline().startswith("bus main ")
        assert process.stdout.readline() == "ready\n"
        with running(f"{daemon} --socket {sockets}", arm, environment):
            wait_for(tmp_path / "runtime", state="connected")
            run(block("5. Arm and move"), arm, environment)
            refused = fenced(section("5. Arm and move"), "console")[0].splitlines()
            done = subprocess.run(
                ["bash", "-c", refused[0].removeprefix("$ ")],
                cwd=arm,
                env=environment,
                capture_output=True,
                text=True,
                timeout=60.0,
            )
            assert done.returncode != 0
            said = done.stderr.splitlines()[0]
            expected = refused[1]
            assert re.sub(r"[\d.]+ s\b", "T", said) == re.sub(r"[\d.]+ s\b", "T", expected)
            play = block("6. Play a motion file")
            if not find_spec("matplotlib"):
                play = "\n".join(line for line in play.splitlines() if " plot " not in line)
            assert "accepted" in run(play, arm, environment)
            assert (arm / "reach.mcap").stat().st_size > 10_000
            assert (arm / "reach.mcap.png").exists() == bool(find_spec("matplotlib"))
            lines = run_python("7. Read the state in Python", arm, environment)
            assert [line.split()[0] for line in lines] == ["shoulder_pitch", "shoulder_roll", "elbow"] * 3
            assert all(line.endswith(" True") for line in lines)
            run(block("8. Stop"), arm, environment)
            wait_for(tmp_path / "runtime", state="connected", armed=False)


def test_the_robot_of_nine_joints_is_armed_and_plays_its_motion(tmp_path: Path) -> None:
    environment = terminal(tmp_path)
    nine = copied("A robot of nine joints", tmp_path, environment)
    check, daemon = block("A robot of nine joints").splitlines()[2:]
    assert run(check, nine, environment).endswith("ok\n")
    (play,) = re.findall(r"`(twindctl play [^`]+)`", section("A robot of nine joints"))
    with running(f"{daemon} --socket {tmp_path}/runtime/twind", nine, environment):
        wait_for(tmp_path / "runtime", state="connected")
        run("twindctl arm", nine, environment)
        run(play, nine, environment)
        run("twindctl disarm", nine, environment)
        wait_for(tmp_path / "runtime", state="connected", armed=False)
