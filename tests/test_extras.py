"""What the learning extras bring is theirs alone: who does not ask for it neither installs nor loads it."""

import re
import subprocess
import sys
import tomllib

from pages import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LIBRARIES = (
    "gymnasium",
    "stable_baselines3",
    "torch",
    "onnx",
    "onnxruntime",
    "pyarrow",
    "matplotlib",
    "OpenGL",
)


def names(asked: list[str]) -> set[str]:
    """Of the distributions that are asked for."""
    return {re.match(r"[\w-]+", each)[0] for each in asked}  # type: ignore[index]


def test_only_who_trains_gets_torch_and_the_tests_get_exactly_one() -> None:
    extras = PROJECT["optional-dependencies"]
    assert "torch" not in names(PROJECT["dependencies"]).union(*(names(each) for each in extras.values()))
    assert [extra for extra, asked in extras.items() if "stable-baselines3" in names(asked)] == ["learn"]
    assert [extra for extra, asked in extras.items() if names(asked) & {"onnx", "onnxruntime"}] == ["learn"]
    pins = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert pins == ["torch==2.13.0"]


def test_nobody_is_told_to_install_twind_by_its_name_which_on_pypi_is_another_projects() -> None:
    """By its path alone: pip takes a name from an index where twind is not there yet, or is to be newer."""
    kinds = {".py", ".md", ".yaml", ".service", ".conf", ".txt"}
    rooms = ("twind", "drivers", "calibration", "docs", "bench", "packaging", "systemd")
    files = [*(ROOT / name for name in ("README.md", "CHANGELOG.md", "Makefile", "constraints.txt"))]
    files += [each for room in rooms for each in (ROOT / room).rglob("*") if each.suffix in kinds]
    named = re.compile(r"pip install\b[^\n`#]*[\s'\"]twind\b(?!/)")
    found = [f"{each.relative_to(ROOT)}: {one}" for each in files for one in named.findall(each.read_text())]
    assert found == []
    assert named.search("pip install 'twind[learn]'") and named.search("pip install --upgrade twind")


def test_every_verb_is_found_and_none_of_them_is_what_a_daemon_or_a_short_verb_waits_for() -> None:
    verbs = PROJECT["entry-points"]["twind.verbs"]
    code = (
        "import sys, importlib\n"
        "import twind.cli, twind.front, twind.front.server, twind.virtual.main, twind.ctl.main\n"
        f"for module in {sorted(verbs.values())!r}: importlib.import_module(module)\n"
        f"print(sorted(set({LIBRARIES!r}) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert done.stdout == "[]\n", done.stdout + done.stderr
