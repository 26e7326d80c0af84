"""Choice of the back end of `twindctl ros` where `--backend` names none. Standard library, Python 3.10."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from twind.bridge.ros.rclpy_launcher import fault, installed
from twind.command_line.verb import UsageError

DDS = "dds"
RCLPY = "rclpy"
ZENOH = "zenoh"
RMW_ZENOH = "rmw_zenoh_cpp"
MIDDLEWARES = (  # those that speak DDS
    "rmw_fastrtps_cpp",
    "rmw_fastrtps_dynamic_cpp",
    "rmw_cyclonedds_cpp",
    "rmw_connextdds",
    "rmw_gurumdds_cpp",
)


def usual(environment: Mapping[str, str], distro: str | None, tell: Callable[[str], None]) -> str:
    """Return the name of the back end: rclpy where it is installed and loads, else one that needs no ROS.

    `distro`: the option `--distro`. `tell` receives one line if an rclpy is installed and cannot be used.
    Raises UsageError if RMW_IMPLEMENTATION names an unknown middleware.
    """
    reason = _unusable(environment, distro)
    if reason == "":
        return RCLPY
    other = without_ros(environment)
    if reason is not None:
        tell(f"{reason}; falling back to --backend {other}")
    return other


def without_ros(environment: Mapping[str, str]) -> str:
    """Name of the back end that fits RMW_IMPLEMENTATION and needs no ROS. Raises UsageError: unknown."""
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware and middleware not in (RMW_ZENOH, *MIDDLEWARES):
        known = ", ".join((RMW_ZENOH, *MIDDLEWARES))
        raise UsageError(f"RMW_IMPLEMENTATION={middleware!r}: must be one of {known}, or name a --backend")
    return ZENOH if middleware == RMW_ZENOH else DDS


def _unusable(environment: Mapping[str, str], distro: str | None) -> str | None:
    """Reason why the installed rclpy cannot be used, "" if it can. None: no rclpy is installed."""
    try:
        found = installed(environment, distro)
    except UsageError as error:
        return str(error)
    return None if found is None else fault(found)
