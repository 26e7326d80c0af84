"""`make install`, `make uninstall` into a folder: what is laid where, what is not overwritten, what stays."""

import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.support.doc_pages_text import FENCE
from tests.support.stand_in_wheels import wheel
from tests.support.unit_file_parser import CLIENTS, SERVICES, SOCKETS, SYSTEMD
from twind.config.daemon_settings import load_settings
from twind.config.robot_file import load_robot

ROOT = SYSTEMD.parent
INSTALL = ROOT / "packaging" / "install.sh"
COMMANDS = ("twind", "twindctl", "twind-virtual")


def install(
    into: Path, *words: str, fails: bool = False, **environment: str
) -> subprocess.CompletedProcess[str]:
    """The script, which must succeed, or fail where that is the claim."""
    done = subprocess.run(
        [INSTALL, *words],
        env=os.environ | {"DESTDIR": str(into)} | environment,
        text=True,
        capture_output=True,
        check=False,
    )
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done


def laid(into: Path, **environment: str) -> None:
    """All but the environment, which takes seconds."""
    install(into, "files", **environment)
    install(into, "settings", **environment)


def contents(folder: Path) -> Mapping[str, tuple[int, str]]:
    """Every path below, with its mode and what it holds or leads to."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            held = f"-> {path.readlink()}"
        else:
            held = path.read_bytes().hex() if path.is_file() else ""
        found[str(path.relative_to(folder))] = (path.lstat().st_mode, held)
    return found


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An installation that tests only read."""
    made = tmp_path_factory.mktemp("installed") / "tree"
    laid(made)
    return made


@pytest.fixture
def tree(installed: Path, tmp_path: Path) -> Path:
    """An installation of a test's own: a copy."""
    return shutil.copytree(installed, tmp_path / "tree", symlinks=True)


def test_everything_has_its_place(installed: Path) -> None:
    found = contents(installed)
    for name in (*SERVICES, *CLIENTS, *SOCKETS):
        assert f"usr/local/lib/systemd/system/{name}" in found
    for name in ("sysusers.d/twind.conf", "tmpfiles.d/twind.conf", "udev/rules.d/60-twind.rules"):
        assert f"usr/local/lib/{name}" in found
    for name in COMMANDS:
        assert found[f"usr/local/bin/{name}"][1] == f"-> /opt/twind/bin/{name}"
    manuals = "-> /opt/twind/bin/../manuals"
    for name, section in (("twind", 8), ("twindctl", 1), ("twind-virtual", 1)):
        assert found[f"usr/local/share/man/man{section}/{name}.{section}"][1] == f"{manuals}/{name}.{section}"
        assert found[f"usr/local/share/bash-completion/completions/{name}"][1] == f"{manuals}/bash/{name}"
        assert found[f"usr/local/share/zsh/site-functions/_{name}"][1] == f"{manuals}/zsh/_{name}"
    for name in ("sim", "twind"):  # masked: sockets, or settings, would be those of another unit
        assert found[f"usr/local/lib/systemd/system/twind@{name}.service"][1] == "-> /dev/null"
    examples = {path.name for path in (SYSTEMD / "examples").iterdir()}
    assert {path.name for path in (installed / "usr/local/share/doc/twind/examples").iterdir()} == examples


def test_every_link_of_the_installed_pages_leads_somewhere(installed: Path) -> None:
    """Nobody on the robot has the sources: what a page sends to lies beside it."""
    folder = installed / "usr/local/share/doc/twind"
    there = {str(page.relative_to(folder)) for page in folder.rglob("*.md")}
    sources = {f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")}
    rooms = ("calibration", "packaging/metrics", "systemd")
    assert there == sources | {"README.md", "CHANGELOG.md", *(f"{room}/README.md" for room in rooms)}
    for each in sorted(there):
        page = folder / each
        links = re.findall(r"\]\(([^)]+)\)", FENCE.sub("", page.read_text()))
        files = [link.partition("#")[0] for link in links if "://" not in link]
        assert not [file for file in files if file and not (page.parent / file).is_file()], each


def test_twice_gives_the_same(tree: Path) -> None:
    before = contents(tree)
    laid(tree)
    assert contents(tree) == before


def test_the_example_settings_are_the_defaults_and_the_example_robot_is_whole(installed: Path) -> None:
    etc = installed / "etc/twind"
    settings = load_settings(etc / "twind.yaml")
    plain = load_settings(None, {"HOME": str(installed / "nobody")}, uid=1000)
    assert (settings.mode, settings.robot, dict(settings.ports)) == (plain.mode, plain.robot, {})
    assert settings.mode == "mirror"
    robot = load_robot("example", [etc / "robots"])
    assert robot.name == "example"
    assert [joint.name for joint in robot.joints] == [joint.name for joint in load_robot("h24", []).joints]
    assert robot.mjcf_path == etc / "robots/example.xml"
    assert robot.mjcf_path.exists()


def test_installed_files_are_readable_by_all_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        laid(tmp_path / "tree")
    finally:
        os.umask(before)
    modes = {path: mode for path, (mode, _) in contents(tmp_path / "tree").items() if not stat.S_ISLNK(mode)}
    assert {"opt/twind", "etc/twind/robots", "usr/local/bin"} < modes.keys()
    for path, mode in modes.items():
        assert mode & 0o055 == (0o055 if stat.S_ISDIR(mode) else 0o044), path


def test_settings_and_robots_that_are_there_are_never_touched(tmp_path: Path) -> None:
    mine = tmp_path / "etc/twind"
    (mine / "robots").mkdir(parents=True)
    (mine / "twind.yaml").write_text("mode: live\n")
    (mine / "robots/mine.yaml").write_text("format: twind-robot/1\n")
    before = contents(mine)
    laid(tmp_path)
    assert contents(mine) == before


def test_a_file_of_an_older_version_is_removed(tree: Path) -> None:
    old = tree / "usr/local/lib/systemd/system/twind-old.service"
    old.write_text("")
    with (tree / "opt/twind/files").open("a") as listed:
        listed.write("/usr/local/lib/systemd/system/twind-old.service\n")
    laid(tree)
    assert not old.exists()


@pytest.mark.parametrize("purge", ["", "1"])
def test_uninstall_keeps_settings_and_state_unless_purged(tree: Path, purge: str) -> None:
    state = ("var/lib/twind/calibration/h24.yaml", "var/lib/private/twind-stream/1.spool")
    for each in state:
        (tree / each).parent.mkdir(parents=True)
        (tree / each).write_text("not empty\n")
    (tree / "var/lib/twind-stream").symlink_to("private/twind-stream")  # as DynamicUser= lays it
    other = tree / "usr/local/bin/other"
    other.write_text("")
    said = install(tree, "uninstall", PURGE=purge).stdout
    left = {path for path, (_, held) in contents(tree).items() if held}
    settings = {"etc/twind/twind.yaml", "etc/twind/robots/example.yaml", "etc/twind/robots/example.xml"}
    assert left == (set() if purge else settings | set(state) | {"var/lib/twind-stream"})
    folders = ["/etc/twind", "/var/lib/twind", "/var/lib/twind-stream", "/var/lib/private/twind-stream"]
    assert re.findall("removed (/.*)", said) == (folders if purge else [])
    assert other.exists()
    assert not (tree / "opt/twind").exists()
    assert not (tree / "usr/local/share/doc/twind").exists()


@pytest.mark.parametrize("with_ours", [False, True])
def test_an_environment_made_by_hand_stays(tmp_path: Path, with_ours: bool) -> None:
    """Uninstalling does not delete files that installing refuses to touch."""
    if with_ours:
        laid(tmp_path)
    top = tmp_path / "opt/twind"
    (top / "bin").mkdir(parents=True)
    (top / "pyvenv.cfg").write_text("home = /usr/bin\n")
    (top / "bin/twind").write_text("#!/bin/sh\n")
    install(tmp_path, "uninstall")
    assert set(contents(top)) == {"bin", "bin/twind", "pyvenv.cfg"}
    assert not (tmp_path / "usr/local/lib/systemd/system/twind.service").exists()


def test_uninstall_keeps_a_foreign_folder(tmp_path: Path) -> None:
    mine = tmp_path / "opt/twind/notes"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine\n")
    install(tmp_path, "uninstall")
    assert mine.read_text() == "mine\n"


def test_install_does_not_replace_a_foreign_command(tmp_path: Path) -> None:
    (tmp_path / "usr/local/bin").mkdir(parents=True)
    (tmp_path / "usr/local/bin/twindctl").write_text("#!/bin/sh\n")
    said = install(tmp_path, "install", fails=True).stderr
    assert f"{tmp_path}/usr/local/bin/twindctl is there already" in said
    assert not (tmp_path / "opt").exists()


def test_an_interpreter_that_will_not_do_is_refused_with_the_reason(tmp_path: Path) -> None:
    old = tmp_path / "python3"
    old.write_text(f'#!/bin/sh\nexec {sys.executable} -c "$(printf %s "$2" | sed \'s/(3, 11)/(99, 0)/\')"\n')
    old.chmod(0o755)
    said = install(tmp_path, "version", fails=True, PYTHON=str(old)).stderr
    assert "twind needs 3.11 or newer" in said
    assert "it does not run" in install(tmp_path, "version", fails=True, PYTHON="/nowhere/python3").stderr


def test_a_relative_destination_is_refused(tmp_path: Path) -> None:
    assert "begins with /" in install(Path("tree"), "install", fails=True, WHEELS=str(tmp_path)).stderr


# -------------------------------------------------------------------------------------- the environment


@pytest.fixture(scope="module")
def usable() -> str:
    """The interpreter that installs; none that will do is a reason to skip."""
    done = subprocess.run([INSTALL, "version"], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(done.stderr.strip())
    return done.stdout.strip()


HOLDS = """
import mmap, sys
file = open(sys.argv[1], "rb")
held = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
print(flush=True)
input()
"""


@pytest.mark.slow
def test_an_environment_is_switched_when_it_is_whole_and_what_still_runs_keeps_its_files(
    tmp_path: Path, usable: str
) -> None:
    """A daemon that was not restarted starts its fronts from where it came from."""
    tree = tmp_path / "tree"
    one = wheel(tmp_path / "one", "1.0.0")
    two = wheel(tmp_path / "two", "2.0.0")
    bin_ = tree / "opt/twind/bin"
    versions = tree / "opt/twind/versions"
    install(tree, "install", WHEELS=str(one))
    first = bin_.readlink()
    assert str(first).startswith("versions/1.0.0-")
    script = (bin_ / "twind").read_text()
    assert script.startswith(f"#!/opt/twind/{first}/python")  # without DESTDIR, and its own version for good
    before = contents(tree)
    install(tree, "install", WHEELS=str(one))
    assert contents(tree) == before
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "twind_robot-3.0.0-py3-none-any.whl").write_text("no archive")
    install(tree, "install", fails=True, WHEELS=str(broken))
    assert bin_.readlink() == first
    assert [path.name for path in versions.iterdir()] == [first.parent.name]
    old = tree / "opt/twind" / first.parent
    extra = f"lib/python{usable}/site-packages/twind_more.py"
    assert not (old / extra).exists()
    mapped = old / "lib" / f"python{usable}" / "mapped"
    mapped.write_bytes(bytes(4096))
    command = [sys.executable, "-c", HOLDS, str(mapped)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"\n"
        said = install(tree, "install", WHEELS=str(two), EXTRAS="more").stdout
        assert f"{old.name} still runs" in said
        assert old.is_dir()
        process.communicate(b"\n")
    second = bin_.readlink()
    assert str(second).startswith("versions/2.0.0-")
    assert (tree / "opt/twind" / second.parent / extra).exists()
    install(tree, "install", WHEELS=str(two))
    assert bin_.readlink() == second, "what is installed anew has the extras that it had"
    assert [path.name for path in versions.iterdir()] == [second.parent.name]
    install(tree, "uninstall")
    assert not (tree / "opt/twind").exists()
