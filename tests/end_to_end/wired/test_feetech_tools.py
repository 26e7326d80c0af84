"""Search and survey of Feetech servos by the verbs, on a pseudo-terminal."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Virtual
from twind.ctl.ctl_main import main

pytestmark = pytest.mark.slow
SO101 = "so101"


def test_servos_of_a_robot_and_a_foreign_one_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*words: str) -> tuple[int, str]:
        code = main(["--socket", str(tmp_path / "nobody"), *words])
        return code, capsys.readouterr().out

    port = str(tmp_path / "ports/main")
    few = ("--port", port, "--kind", "feetech", "--baud", "1000000", "--ids", "0-9")
    words = ("--robot", SO101, "--port", port)
    servos = Virtual(tmp_path, SO101, "--muscles", "first-order", "--servo", "main:9:STS3250")
    try:
        code, listed = run("scan", *few)
        assert (code, listed.count("STS3215"), listed.count("STS3250")) == (0, 6, 1)
        code, text = run("calibrate", "scan", "--json", *words)
    finally:
        servos.close()
    survey: dict[str, Any] = json.loads(text)
    assert (code, [each["id"] for each in survey["devices"]]) == (1, [1, 2, 3, 4, 5, 6, 9])
    assert [each["code"] for each in survey["found"]] == ["SERVO_FOREIGN"]
