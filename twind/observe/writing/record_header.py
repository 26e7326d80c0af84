"""Head of a recording, of whatever writer: metadata of its clocks, and attached files. Pure."""

import json
from collections.abc import Mapping
from typing import Any

from twind.client.clock_pair import ClockPair
from twind.observe.recording.recording_topics import CALIBRATION, MJCF, ROBOT


def clock_words(clocks: ClockPair) -> dict[str, str]:
    """Build the clock entries of the metadata: both clocks at one moment, and how they give log times."""
    return {
        "monotonic": repr(clocks.monotonic),
        "wall_ns": str(clocks.wall_ns),
        "clock": "log times are wall clock, ns since 1970: wall_ns + (CLOCK_MONOTONIC - monotonic)",
    }


def attachments(
    robot: Mapping[str, Any], calibration: Mapping[str, Any] | None, mjcf: str | None
) -> dict[str, tuple[str, bytes]]:
    """Media type and bytes by name; what a robot has not is left out."""

    def text(value: Any) -> bytes:
        return json.dumps(value, ensure_ascii=False).encode()

    found = {ROBOT: ("application/json", text(robot))}
    if calibration:
        found[CALIBRATION] = ("application/json", text(calibration))
    if mjcf:
        found[MJCF] = ("application/xml", mjcf.encode())
    return found
