"""Parameters of the node under rclpy: the daemon's settings, read and, where it permits, written.

Standard library and rclpy; Python 3.10.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from twind.bridge.commands.stop_queues import Outcome
from twind.bridge.ros.ros_endpoints import TO_MODE, RosService
from twind.bridge.ros.ros_transport import RequestHandler, answer_to
from twind.client import ClientError

MODE = "mode"
UNKNOWN = "unknown"  # value of `mode` while no daemon reports its mode
PERIOD = 1.0  # s between two readings of the settings
ABOUT = {
    MODE: "sim, mirror or live; unknown: no daemon",
    "rate": "Hz, of the control loop; from the robot file",
    "latency_warn_ms": "ms, a latency above it is reported; may only be lowered",
    "latency_block_ms": "ms, no motion begins above it; may only be lowered",
    "log_level": "debug, info, warning or error",
}

# The daemon's settings after these changes: the answer of GetParameters or SetParameters, or an error.
Settings = Callable[[Mapping[str, Any]], Outcome]


class DaemonParameters:
    """Parameters with the daemon's values. Setting one is a request to the daemon, which may refuse.

    All but `show` runs in the default group, as the parameter services: so `_following` needs no lock.
    """

    def __init__(
        self, node: Any, asked: RequestHandler, offered: Collection[RosService], settings: Settings
    ) -> None:
        """Make the parameters; `offered`: services that are served; a mode without one cannot be requested
        here.
        """
        self._node = node
        self._call_service = asked
        self._offered = offered
        self._settings = settings
        self._status: Mapping[str, Any] = {}
        self._read_at = float("-inf")
        self._values: dict[str, Any] = {}
        self._following = False
        self._show({MODE: UNKNOWN})
        node.add_on_set_parameters_callback(self._on_set)
        self._news = node.create_guard_condition(self._follow)

    def show(self, status: Mapping[str, Any]) -> None:
        """Take the daemon's status; from any thread."""
        now = time.monotonic()
        changed = status.get(MODE) != self._status.get(MODE)
        self._status = status
        if changed or now - self._read_at >= PERIOD:
            self._read_at = now
            self._news.trigger()

    def _follow(self) -> None:
        status = self._status
        found = {MODE: status.get(MODE) or UNKNOWN}
        outcome = self._settings({}) if MODE in status else {}
        if not isinstance(outcome, ClientError):
            settings = outcome.get("parameters") or {}
            found |= {key: settings[key] for key in ABOUT if key not in found and key in settings}
        if "loop" in status:
            found["rate"] = float(status["loop"]["rate_hz"])
        self._following = True
        try:
            self._show(found)
        finally:
            self._following = False

    def _show(self, found: Mapping[str, Any]) -> None:
        for name, value in found.items():
            if name not in self._values:  # ignore_override: `-p` would show a value that is not the daemon's
                about = ParameterDescriptor(description=ABOUT[name])
                self._node.declare_parameter(name, value, about, ignore_override=True)
            elif self._values[name] != value:
                self._node.set_parameters([Parameter(name, value=value)])
            self._values[name] = value

    def _on_set(self, parameters: Sequence[Any]) -> Any:
        reason = "" if self._following else self._refusal({each.name: each.value for each in parameters})
        return SetParametersResult(successful=not reason, reason=reason)

    def _refusal(self, wanted: Mapping[str, Any]) -> str:
        """Return why the daemon does not take these values; "": it does. Other names are the node's own."""
        settings = {name: value for name, value in wanted.items() if name in self._values and name != MODE}
        if settings and MODE in wanted:
            return f"{MODE} and {', '.join(settings)}: set them one after the other"
        reason = self._mode_refusal(wanted[MODE]) if MODE in wanted else ""
        outcome = self._settings(settings) if settings else {}
        if isinstance(outcome, ClientError):
            return str(outcome)
        if not reason:
            self._values |= {name: wanted[name] for name in wanted if name in self._values}
        return reason

    def _mode_refusal(self, mode: Any) -> str:
        if mode not in TO_MODE:
            return f"{MODE} {mode!r}: must be one of {', '.join(TO_MODE)}"
        if TO_MODE[mode] not in self._offered:
            return "no commands are taken from ROS here"
        done, words = answer_to(self._call_service, TO_MODE[mode], None)
        return "" if done else words
