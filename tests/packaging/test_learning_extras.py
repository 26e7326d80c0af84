"""Libraries of the learning extras: an installation without the extras neither installs nor loads them."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT
from twind.command_line.extras import clone, command

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LIBRARIES = (
    "gymnasium",
    "stable_baselines3",
    "torch",
    "onnx",
    "onnxruntime",
    "lerobot",
    "matplotlib",
    "OpenGL",
)


def names(asked: list[str]) -> set[str]:
    """Names of the requested distributions."""
    return {re.match(r"[\w-]+", each)[0] for each in asked}  # type: ignore[index]


def advising() -> list[Path]:
    """Files that may tell how twind is installed."""
    kinds = {".py", ".md", ".yaml", ".service", ".conf", ".txt"}
    rooms = ("twind", "drivers", "calibration", "docs", "bench", "packaging", "systemd")
    files = [*(ROOT / name for name in ("README.md", "CHANGELOG.md", "Makefile", "constraints.txt"))]
    return files + [each for room in rooms for each in (ROOT / room).rglob("*") if each.suffix in kinds]


def test_only_who_trains_gets_torch_and_the_tests_get_exactly_one() -> None:
    extras = PROJECT["optional-dependencies"]
    assert "torch" not in names(PROJECT["dependencies"]).union(*(names(each) for each in extras.values()))
    assert [extra for extra, asked in extras.items() if "stable-baselines3" in names(asked)] == ["learn"]
    assert [extra for extra, asked in extras.items() if "onnx" in names(asked)] == ["learn"]
    assert [extra for extra, asked in extras.items() if "onnxruntime" in names(asked)] == ["policy"]
    pins = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    heavy = {pin for pin in pins if pin.startswith(("torch", "onnx", "stable"))}
    assert heavy == {"torch==2.13.0", "onnxruntime==1.32.0"}


def test_no_document_suggests_installing_twind_by_name_from_pypi() -> None:
    """By its path alone: pip takes a name from an index where twind is not there yet, or is to be newer."""
    named = re.compile(r"pip install\b[^\n`#]*[\s'\"]twind\b(?!/)")
    found = [
        f"{each.relative_to(ROOT)}: {one}" for each in advising() for one in named.findall(each.read_text())
    ]
    assert found == []
    assert named.search("pip install 'twind[learn]'") and named.search("pip install --upgrade twind")


def test_no_page_and_no_message_advises_an_install_into_the_environment_of_the_clone() -> None:
    """There pip without `--editable` replaces the clone by a copy. Another environment is named."""
    bare = re.compile(r"(?<![/\w])(?<!-m )pip install +[^`\s]|\.venv/bin/(?:python -m )?pip install")
    assert bare.search("pip install '.[view]'") and bare.search("once: .venv/bin/pip install .")
    assert not bare.search("~/twind-env/bin/pip install '.[view]'")
    found = [(each.relative_to(ROOT), one) for each in advising() for one in bare.findall(each.read_text())]
    assert found == []


@pytest.mark.parametrize(
    ("prefix", "source", "line"),
    [
        ("clone/.venv", "clone", "make -C {0}/clone extras EXTRAS=view"),
        ("env", "clone", "/PYTHON -m pip install --constraint {0}/clone/constraints.txt '{0}/clone[view]'"),
        ("env", None, "in the clone of twind, /PYTHON -m pip install '.[view]'"),
        ("opt/versions/1", None, "in the clone of twind, sudo make install EXTRAS=ros,view"),
    ],
)
def test_the_command_for_an_extra_is_that_of_the_environment_at_hand(
    prefix: str, source: str | None, line: str, tmp_path: Path
) -> None:
    (tmp_path / "opt").mkdir()
    (tmp_path / "opt" / "extras").write_text("ros\n")
    found = command("view", tmp_path / prefix, "/PYTHON", None if source is None else tmp_path / source)
    assert found == line.format(tmp_path)


def test_the_clone_is_the_folder_that_pip_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my twind"
    info = tmp_path / "site" / "twind_robot-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: twind-robot\nVersion: 1\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "site")])
    assert clone() is None
    (info / "direct_url.json").write_text(json.dumps({"url": folder.as_uri(), "dir_info": {}}))
    assert clone() is None
    folder.mkdir()
    (folder / "pyproject.toml").touch()
    assert clone() == folder


@pytest.mark.parametrize(
    ("paths", "healed"), [(("",), False), (("", "/drivers"), False), (("/drivers",), True), ((), True)]
)
def test_make_repairs_an_environment_whose_editable_install_was_replaced(
    tmp_path: Path, paths: tuple[str, ...], healed: bool
) -> None:
    folder = tmp_path / "my clone"
    site = folder / ".venv" / "lib" / "python3.11" / "site-packages"
    site.mkdir(parents=True)
    shutil.copy(ROOT / "Makefile", folder)
    (folder / "pyproject.toml").touch()
    (folder / ".venv" / ".ready").touch()
    if paths:
        (site / "any.pth").write_text("\n".join(f"{folder}{each}" for each in paths))
    plan = subprocess.run(
        ["make", "--dry-run", "test-fast"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout
    assert ("--editable '.[dev]'" in plan) is healed
    assert ("installed editable again" in plan) is healed
    assert "pytest" in plan


def test_the_tests_import_the_sources_of_their_folder_though_a_copy_is_installed(tmp_path: Path) -> None:
    """As after `pip install .`: no path of the clone is among those of the interpreter."""
    code = (
        "import sys, pytest\n"
        f"ours = [{str(ROOT)!r}, *(each for each in sys.path if each.startswith({str(ROOT)!r} + '/'))]\n"
        "sys.path[:] = [each for each in sys.path if each not in ours or '/.venv/' in each]\n"
        "sys.exit(pytest.main(['-p', 'no:xdist', '-p', 'no:cacheprovider', '--collect-only',"
        " 'tests/drivers/test_mit_frame.py', 'tests/proof/mutation/test_mutation_tool.py']))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120.0
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_verb_is_found_and_none_of_them_is_what_a_daemon_or_a_short_verb_waits_for() -> None:
    verbs = PROJECT["entry-points"]["twind.verbs"]
    code = (
        "import sys, importlib\n"
        "import twind.cli, twind.front, twind.front.front_server\n"
        "import twind.virtual.virtual_main, twind.ctl.ctl_main\n"
        f"for module in {sorted(verbs.values())!r}: importlib.import_module(module)\n"
        f"print(sorted(set({LIBRARIES!r}) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert done.stdout == "[]\n", done.stdout + done.stderr
