"""`twindctl calibrate scan` on a free port: everything that is wrong with anybody, told in one go."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Virtual
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main

pytestmark = pytest.mark.slow

NECK = "head_pitch:       {id: 2,"


def test_missing_unknown_doubled_and_wrong_devices_are_all_listed_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = load_robot("h24")
    text = known.path.read_text().replace("mjcf: h24.xml", f"mjcf: {known.mjcf_path}")
    begin = text.index("  xm430:\n")
    end = text.index("defaults:")
    kind = text[begin:end].replace("xm430:", "xm540:").replace("XM430-W350", "XM540-W150").rstrip()
    text = f"{text[:begin]}{kind}\n{text[begin:]}"
    described = tmp_path / "h24.yaml"
    described.write_text(text.replace(NECK, f"{NECK} type: xm540,"))
    extra = ["--servo", "main:40:XM430-W350", "--servo", "main:9:XM430-W350"]
    virtual = Virtual(tmp_path, "h24", "--muscles", "first-order", *extra)
    try:
        virtual.order(fault="silence", id=5)
        virtual.order(fault="collide", on=True)
        words = ["--robot", str(described), "--port", str(tmp_path / "ports" / "main")]
        code = main(["--socket", str(tmp_path / "nobody"), "calibrate", "scan", "--json", *words])
    finally:
        virtual.close()
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    codes = {found["code"]: found["thing"] for found in told["found"]}
    assert code == 1 and {"SERVO_MISSING", "SERVO_FOREIGN", "ID_TWICE", "SERVO_MODEL"} <= set(codes)
    assert "id 5 (l_shoulder_yaw)" in codes["SERVO_MISSING"]
    assert "id 40" in codes["SERVO_FOREIGN"] and "id 9" in codes["ID_TWICE"]
    assert "id 2 (head_pitch)" in codes["SERVO_MODEL"]
    knee = next(each for each in told["devices"] if each["joint"] == "l_knee")
    assert (knee["id"], knee["model"], knee["homing_offset"], knee["operating_mode"]) == (
        16,
        "XM430-W350",
        0,
        3,
    )
