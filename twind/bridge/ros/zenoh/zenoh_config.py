"""Configuration of a ROS node's Zenoh session, by default as `rmw_zenoh_cpp` sets it up.

A peer: it connects to the router of this machine, learns of the other peers from it, and connects to those
directly. It listens on loopback alone. Messages to other machines go through the router, whose configuration
decides that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import zenoh

from twind.bridge.ros.ros_trajectory import LONGEST
from twind.exceptions import OperationFailed

ROUTER = "tcp/localhost:7447"  # rmw_zenohd of this machine
# what users of rmw_zenoh set
CONFIG = "ZENOH_SESSION_CONFIG_URI"
OVERRIDE = "ZENOH_CONFIG_OVERRIDE"
_AGAIN_MS = (200, 2000)  # ms, pause between attempts to reach an absent router, and its upper bound


def session_config(
    environment: Mapping[str, str], connect: str | None, file: Path | str | None
) -> zenoh.Config:
    """Return the configuration by the options, else by the variables that ROS users set, else the default.

    `connect`: the router's address, or several by commas; `file`: a Zenoh configuration, taken as it is.
    Raises OperationFailed.
    """
    path = str(file or ("" if connect else environment.get(CONFIG, "")))
    try:
        found = (
            zenoh.Config.from_file(path) if path else zenoh.Config.from_json5(json.dumps(_default(connect)))
        )
    except zenoh.ZError as error:
        raise OperationFailed(f"zenoh: {path or connect}: {error}") from None
    for part in filter(None, environment.get(OVERRIDE, "").split(";")):
        key, _, value = part.partition("=")
        try:
            found.insert_json5(key.strip(), value.strip())
        except zenoh.ZError as error:
            raise OperationFailed(f"zenoh: {OVERRIDE}: {part!r}: {error}") from None
    return found


def _default(connect: str | None) -> Mapping[str, object]:
    first, last = _AGAIN_MS
    return {
        "mode": "peer",
        "connect": {
            "endpoints": [each.strip() for each in (connect or ROUTER).split(",")],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": first, "period_max_ms": last, "period_increase_factor": 2},
        },
        "listen": {"endpoints": ["tcp/localhost:0"]},
        "scouting": {
            "multicast": {"enabled": False},
            "gossip": {"enabled": True, "target": {"router": ["router", "peer"], "peer": ["router"]}},
        },
        "timestamping": {"enabled": True},  # what is latched is kept by its time
        "transport": {
            "shared_memory": {"enabled": False},  # no message is large enough for it
            "link": {"rx": {"max_message_size": LONGEST + 65536}},  # of far longer ones nothing is kept
        },
    }
