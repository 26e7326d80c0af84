"""The help of a verb lists the common options that have an effect on it, and no others."""

import pytest

from twind.ctl.ctl_main import command_parser, main
from twind.version import __version__

COMMON = ("--socket", "-i NAME", "--remote", "--json")


@pytest.mark.parametrize(
    ("verb", "listed"),
    [
        ("status", COMMON),
        ("arm", (*COMMON[:2], "--json")),
        ("demo", ()),
        ("video", ("--json",)),
        ("teleop", (*COMMON[:2], "--json")),
    ],
)
def test_the_help_of_a_verb_lists_only_common_options_with_an_effect(
    verb: str, listed: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        command_parser([verb]).parse_args([verb, "--help"])
    text = capsys.readouterr().out
    assert tuple(option for option in COMMON if option in text) == listed


def test_an_option_that_the_help_omits_is_still_read_so_that_it_can_be_refused() -> None:
    assert command_parser(["teleop"]).parse_args(["teleop", "--remote", "h24"]).remote == "h24"


def test_the_program_tells_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and capsys.readouterr().out == f"twindctl {__version__}\n"
