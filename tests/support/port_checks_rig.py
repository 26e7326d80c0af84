"""Helpers shared by the computed and the real-time tests of doctor ports."""

from tests.support.doctor_rig import found
from twind.doctor.host_inspector import HostInspector


def codes(path: object, code: str, on: HostInspector | None = None) -> list[str]:
    return [each.thing for each in found("--port", str(path), code=code, on=on)]
