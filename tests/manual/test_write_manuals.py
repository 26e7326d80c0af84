"""Manual pages and completion scripts: complete, readable by groff, run by bash, linked by the installer."""

import argparse
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from twind.ctl.ctl_main import main
from twind.ctl.verb_catalog import verb_names
from twind.manual.argument_parsers import ProgramManual, arguments, option_names, programs, subcommands
from twind.manual.write_manuals import write_manuals

INSTALL = Path(__file__).parents[2] / "packaging" / "install.sh"
WORDS = re.compile(r"\\f[BIR]|\\&")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("manuals") / "new"
    write_manuals(made)
    return made


@pytest.fixture(scope="module")
def every() -> tuple[ProgramManual, ...]:
    """All programs, with their parsers."""
    return programs()


def page(folder: Path, name: str) -> str:
    """A manual page without its fonts and escapes."""
    return WORDS.sub("", (folder / name).read_text()).replace(r"\-", "-")


def test_a_page_has_every_option_of_its_program(folder: Path, every: tuple[ProgramManual, ...]) -> None:
    for program in every:
        text = page(folder, f"{program.name}.{program.section}")
        for each in arguments(program.parser):
            assert f".TP\n{each.name}\n" in text, (program.name, each.name)


def test_the_page_of_twindctl_has_every_verb_with_its_options(
    folder: Path, every: tuple[ProgramManual, ...]
) -> None:
    text = page(folder, "twindctl.1")
    program = next(each for each in every if each.name == "twindctl")
    verbs = subcommands(program.parser)
    assert set(verbs) == set(verb_names())
    for name, parser in verbs.items():
        section = text.partition(f".SS {name}\n")[2].partition("\n.S")[0]
        for each in arguments(parser, option_names(program.parser)):
            assert f".TP\n{each.name}\n" in section, (name, each.name)
        for step in subcommands(parser):
            assert f".SS {name} {step}\n" in text


def test_every_argument_of_every_program_has_a_help(every: tuple[ProgramManual, ...]) -> None:
    def missing(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
        yield from (f"{name} {each.name}" for each in arguments(parser) if not each.help)
        for step, child in subcommands(parser).items():
            yield from missing(child, f"{name} {step}")

    assert [each for program in every for each in missing(program.parser, program.name)] == []


def test_groff_reads_every_page_without_a_warning(folder: Path) -> None:
    if shutil.which("groff") is None:
        pytest.skip("no groff")
    for each in sorted(folder.glob("*.[18]")):
        done = subprocess.run(["groff", "-man", "-Tutf8", "-ww", "-z", each], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ""), each.name


def completed(script: Path, words: Sequence[str], within: Path) -> set[str]:
    """Words that bash offers for the last of `words`."""
    program = words[0]
    array = " ".join(f"'{word}'" for word in words)
    code = f"""
source {script}
COMP_WORDS=({array}); COMP_CWORD={len(words) - 1}
$(complete -p {program} | sed 's/.*-F \\([^ ]*\\) .*/\\1/') {program} '{words[-1]}' 2>/dev/null
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True, cwd=within)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["twindctl", "mo"], {"mode", "move", "monitor"}),
        (["twindctl", "--json", "--socket", "/x", "dis"], {"disarm"}),
        (["twindctl", "calibrate", "z"], {"zero"}),
        (["twindctl", "estop", "--c"], {"--cut"}),
        (["twindctl", "completion", ""], {"bash", "zsh"}),
        (["twindctl", "plot", "one"], {"one.mcap"}),
        (["twindctl", "record", "--out", "one"], {"one.mcap"}),
        (["twind", "--mode", "mi"], {"mirror"}),
        (["twind", "--config", "one"], {"one.mcap"}),
        (["twind-virtual", "--no-w"], {"--no-wire-timing"}),
    ],
)
def test_bash_completes(folder: Path, tmp_path: Path, words: list[str], offered: set[str]) -> None:
    (tmp_path / "one.mcap").touch()
    assert completed(folder / "bash" / words[0], words, tmp_path) == offered


def test_the_script_for_zsh_is_one_for_its_program(folder: Path, every: tuple[ProgramManual, ...]) -> None:
    for program in every:
        script = (folder / "zsh" / f"_{program.name}").read_text()
        assert script.startswith(f"#compdef {program.name}\n")
        if shutil.which("zsh"):
            subprocess.run(["zsh", "-n", folder / "zsh" / f"_{program.name}"], check=True)


def test_the_verb_prints_the_script_that_is_installed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for shell, name in (("bash", "bash/twindctl"), ("zsh", "zsh/_twindctl")):
        assert main(["completion", shell]) == 0
        assert capsys.readouterr().out == (folder / name).read_text()


def test_the_installer_links_exactly_the_files_that_are_written(folder: Path, tmp_path: Path) -> None:
    subprocess.run([INSTALL, "files"], env=os.environ | {"DESTDIR": str(tmp_path)}, check=True)
    marker = "/opt/twind/bin/../manuals/"
    targets = [str(path.readlink()) for path in tmp_path.rglob("*") if path.is_symlink()]
    linked = {target.removeprefix(marker) for target in targets if target.startswith(marker)}
    assert linked == {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
