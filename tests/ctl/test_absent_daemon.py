"""Commands that need a daemon, where there is none."""

from pathlib import Path

import pytest

from twind.ctl.ctl_main import main

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
