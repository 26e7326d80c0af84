"""Options of `twindctl uplink`: invalid ones are refused before any connection."""

import argparse
import sys

import pytest

from twind.bridge.uplink import uplink_command
from twind.bridge.zenoh import zenoh_session
from twind.command_line.common_options import add_common_options
from twind.command_line.extras import how_to_add
from twind.command_line.verb import UsageError


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    add_common_options(parser, None)
    uplink_command.add_arguments(parser)
    return uplink_command.run(parser.parse_args(words))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--name", "a/b"), "'a/b'"),
        (("--name", ""), "1 to 64"),
        (("--name", ".hidden"), "dot"),
        (("--name", "*"), r"'\*'"),
        (("--seconds", "0"), "above 0"),
        (("--seconds", "nan"), "above 0"),
    ],
)
def test_an_invalid_uplink_option_is_refused_before_any_connection(
    words: tuple[str, ...], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run("--connect", "tcp/127.0.0.1:1", *words)


def test_a_missing_zenoh_module_is_reported_with_its_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(UsageError) as told:
        run("--connect", "tcp/127.0.0.1:1")
    assert how_to_add("zenoh") in str(told.value)


def test_a_way_that_others_can_read_is_named(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        zenoh_session, "open_session", lambda place, stop, tell: None
    )  # nobody is connected to
    words = ("--connect", "tcp/192.0.2.1:7447", "--connect", "tls/192.0.2.1:7447", "--seconds", "0.1")
    assert run(*words) == 0
    said = capfd.readouterr().err
    assert "tcp/192.0.2.1:7447: every host on the path" in said and "tls/192.0.2.1" not in said
