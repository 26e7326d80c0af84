"""Commands that need a daemon, where there is none."""

import os
from pathlib import Path

import pytest

from twind.command_line.verb import Rejected
from twind.ctl import lost_socket_daemon, teach_command
from twind.ctl.ctl_main import main
from twind.ctl.lost_socket_daemon import LostSocketDaemon

COMMANDS = (
    "monitor",
    "record",
    "view",
    "scan",
    "wiggle l_knee",
    "calibrate sweep",
    "calibrate prove --base back --yes",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_without_a_daemon_exits_with_three(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--socket", str(tmp_path), *command.split()]) == 3
    said = capsys.readouterr()
    assert "no daemon" in said.err and not said.out


def test_an_absent_leader_is_not_taken_for_a_daemon_whose_sockets_are_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = LostSocketDaemon(str(tmp_path), os.getuid(), os.getpid())
    monkeypatch.setattr(lost_socket_daemon, "find", lambda *_, **__: [mine])
    assert main(["--socket", str(tmp_path), "follow", str(tmp_path / "leader"), str(tmp_path)]) == 3
    error = capsys.readouterr().err
    assert f"{tmp_path}/leader/observe.sock: no daemon" in error
    assert "estop" not in error
    assert main(["--socket", str(tmp_path), "status"]) == 3
    assert "its sockets are gone" in capsys.readouterr().err


def test_the_start_command_names_the_instance(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["-i", "nobody", "status"]) == 3
    assert "start it with `systemctl start twind@nobody`" in capsys.readouterr().err


def test_commands_in_an_error_reach_the_daemon_of_this_call(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> int:
        raise Rejected("mode sim reads no robot: `twindctl mode mirror`")

    monkeypatch.setattr(teach_command, "run", refuse)
    assert main(["--socket", "/x", "teach", "swing"]) == 1
    assert capsys.readouterr().err.endswith("`twindctl --socket /x mode mirror`\n")
