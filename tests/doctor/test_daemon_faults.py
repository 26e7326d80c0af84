"""Faults that a running daemon reports, one finding a code."""

from types import SimpleNamespace
from typing import Any, cast

from twind.doctor.check_context import CheckContext
from twind.doctor.daemon import check_faults


def found_of(faults: list[dict[str, Any]]) -> list[tuple[str, str]]:
    daemon = SimpleNamespace(status={"faults": faults}, path="/run/twind/observe.sock")
    context = cast(CheckContext, SimpleNamespace(need_daemon=lambda: daemon))
    return [(each.thing, each.measured) for each in check_faults(context)]


def test_a_fault_of_many_joints_is_one_finding() -> None:
    names = [f"joint_{number}" for number in range(12)]
    faults = [
        {"code": "CALIB_MISSING", "joint": name, "message": f"{name}: not calibrated"} for name in names
    ]
    faults.append({"code": "HW_DISCONNECTED", "joint": None, "message": "main: no device"})
    (missing, lost) = found_of(faults)
    assert missing[0].startswith("CALIB_MISSING, 12 joints: joint_0, joint_1")
    assert missing[1].startswith("joint_0: not calibrated; ") and missing[1].endswith(" more")
    assert lost == ("HW_DISCONNECTED", "main: no device")
