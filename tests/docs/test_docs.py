"""The documents say what can be done: links lead somewhere, commands exist, examples run."""

import re
import shlex
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.doc_pages_text import FENCE, NOT_ON_THE_SITE, PAGES, README, ROOT, fenced, name
from tests.support.docs_rig import readme_lines
from twind import cli
from twind.config import daemon_settings
from twind.ctl import ctl_main as ctl
from twind.virtual import virtual_main as virtual

# ----------------------------------------------------------------------------------------------- links


def test_every_relative_link_leads_somewhere() -> None:
    for page in [*PAGES, *NOT_ON_THE_SITE]:
        prose = FENCE.sub("", page.read_text())
        links = [link for link in re.findall(r"\]\(([^)]+)\)", prose) if "://" not in link]
        broken = [link for link in links if not (page.parent / link.partition("#")[0]).exists()]
        assert not broken, page


def test_every_path_of_this_repository_that_is_named_exists() -> None:
    for page in [*PAGES, *NOT_ON_THE_SITE]:
        spans = re.findall(
            r"`((?:tests|docs|systemd|twind|drivers|calibration|bench|packaging)/[\w./-]+)`", page.read_text()
        )
        environments = re.compile(r"twind/\w+-v\d+")  # names as Gymnasium has them
        assert not [
            span for span in spans if not environments.fullmatch(span) and not (ROOT / span).exists()
        ], page


# ----------------------------------------------------------------------------------------------- commands

PROGRAMS = ("twindctl", "twind", "twind-virtual")
PLACEHOLDERS = {
    "ID": "1",
    "VALUE": "5",
    "COUNTS": "5",
    "NUMBER": "5",
    "VERB": "status",
}  # where a parser wants a number, or a name that exists


def commands(text: str) -> Iterator[list[str]]:
    """Every call of one of our programs: lines of `sh` blocks, and code spans."""
    lines = [line for block in fenced(text, "sh") for line in block.splitlines()]
    lines += re.findall(r"`([^`\n]+)`", FENCE.sub("", text).replace("\\|", "|"))
    for line in lines:
        for part in re.split(r"&&?|\|\|?|;", line):
            if part.split()[:1] and part.split()[0] in PROGRAMS:
                words = shlex.split(part, comments=True)
                yield [PLACEHOLDERS.get(word, word) for word in words]


@cache
def _parser(program: str, words: tuple[str, ...]) -> ArgumentParser:
    """The parser of a program; `words` begin with the verb, or are all words."""
    if program == "twindctl":
        return ctl.command_parser(words)
    return cli.parser() if program == "twind" else virtual.parser()


def parses(words: list[str]) -> bool:
    """The program's own parser takes them."""
    program, *given = words
    if "..." in given or any(word.startswith("[") for word in given):
        return True  # a synopsis
    try:
        _parser(program, tuple(given[:1] if given[:1] and given[0][0] != "-" else given)).parse_args(given)
    except SystemExit as end:
        return end.code == 0  # --help
    return True


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_command_with_its_options_exists(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = [words for words in commands(page.read_text()) if not parses(words)]
    assert not wrong, capsys.readouterr().err


def test_the_commands_are_found_in_the_pages_at_all() -> None:
    found = [" ".join(words) for page in PAGES for words in commands(page.read_text())]
    assert "twindctl arm" in found and "twindctl reboot main 1" in found and len(found) > 60
    assert not parses(["twindctl", "dance"]) and not parses(["twindctl", "arm", "--cut"])


def test_every_make_command_is_a_target() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    pages = [*PAGES, *NOT_ON_THE_SITE]
    asked = [
        line for page in pages for block in fenced(page.read_text(), "sh") for line in block.splitlines()
    ]
    asked += [span for page in pages for span in re.findall(r"`(make [^`]+)`", page.read_text())]
    makes = [line.split()[1] for line in asked if line.startswith("make ")]
    assert {"demo", "test"} <= set(makes) <= targets


def test_pictures_are_shown_and_small() -> None:
    pictures = sorted((ROOT / "docs" / "pictures").iterdir())
    shown = " ".join(page.read_text() for page in PAGES)
    assert [each.name for each in pictures] == [
        "curve.png",
        "fleet.png",
        "gap.png",
        "monitor.svg",
        "plot.png",
        "robots.png",
        "stand.png",
        "view.png",
    ]
    for each in pictures:
        assert f"pictures/{each.name})" in shown
        assert 20_000 < each.stat().st_size < 300_000
        assert each.read_bytes().startswith(b"\x89PNG" if each.suffix == ".png" else b"<svg")


# ---------------------------------------------------------------------------------------------- examples, run

EXCERPTS = ("drivers/README.md",)  # a method out of a class of the sources


@pytest.mark.parametrize("page", [page for page in PAGES if name(page) not in EXCERPTS], ids=name)
def test_every_python_example_imports_what_it_uses(page: Path) -> None:
    """An example may use `robot`, the open one of the examples before it."""
    for example in fenced(page.read_text(), "python"):
        ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--quiet", "--output-format", "concise"]
        ruff += ["--select", "E9,F", "--ignore", "F401", "--config", 'builtins=["robot"]', "-"]
        found = subprocess.run(ruff, input=example, text=True, capture_output=True, check=False)
        assert found.returncode == 0, found.stdout + found.stderr + example


def test_the_settings_of_the_readme_are_settings(tmp_path: Path) -> None:
    (yaml,) = fenced(README, "yaml")
    (tmp_path / "twind.yaml").write_text(yaml)
    read = daemon_settings.load_settings(tmp_path / "twind.yaml", environ={}, uid=0)
    assert (read.mode, read.robot, list(read.ports)) == ("mirror", "h24", ["main"])


def test_the_files_that_root_copies_are_there_and_the_unit_starts_what_is_installed() -> None:
    for line in readme_lines():
        if line.startswith("sudo cp "):
            assert (ROOT / line.split()[2]).is_file()
    unit = (ROOT / "systemd" / "twind.service").read_text()
    assert "ReadWritePaths=-/run/twind\n" in unit  # without the dash a missing folder is 226/NAMESPACE
    given = dict(re.findall(r"(XDG_\w+)=(\S+)", unit))
    places = daemon_settings.places({**given, "STATE_DIRECTORY": "/var/lib/twind"}, uid=990)
    assert [str(place) for place in (places.config, places.state, places.sockets)] == [
        "/etc/twind",
        "/var/lib/twind",
        "/run/twind",
    ]
