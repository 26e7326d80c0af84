"""Catalogue of verbs: every verb has its group and its line, and the help lists all of them."""

import re
import types
from importlib import metadata

import pytest

from twind.command_line.verb import EXIT_CODES, GROUPS
from twind.ctl.ctl_main import main
from twind.ctl.verb_catalog import OTHER, find_verb, grouped_verbs, summary, verb_names

WIDTH = 96  # columns of a line of the help, the name included


def test_a_verb_declares_its_group_and_one_plain_line() -> None:
    for name in verb_names():
        verb = find_verb(name)
        assert verb is not None, name
        assert verb.group in GROUPS, name
        assert re.fullmatch(r"[A-Z][^\n]*(\.|\.\.\.)", summary(verb)), name
        assert len(f"  {name:<11} {summary(verb)}") <= WIDTH, name


def test_the_help_lists_every_verb_below_its_heading(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    help_page = capsys.readouterr().out
    headings = re.findall(rf"^({'|'.join(GROUPS)}):$", help_page, re.MULTILINE)
    assert headings == list(GROUPS)
    for group, verbs in grouped_verbs().items():
        block = help_page.partition(f"\n{group}:\n")[2].partition("\n\n")[0].splitlines()
        assert [line.split()[0] for line in block] == list(verbs)
    codes = help_page.partition("\nexit codes:\n")[2].partition("\n\n")[0].splitlines()
    assert [line.split(maxsplit=1) for line in codes] == [
        [str(code), text] for code, text in EXIT_CODES.items()
    ]


def test_an_installed_verb_without_a_group_is_listed_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin = types.ModuleType("plugin", "Juggle three balls.")
    point = types.SimpleNamespace(name="juggle", load=lambda: plugin)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    assert list(grouped_verbs()[OTHER]) == ["juggle"]


def test_an_unknown_verb_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["dance"])
    assert end.value.code == 2
    refusal = capsys.readouterr().err
    assert "status" in refusal and "calibrate" in refusal
