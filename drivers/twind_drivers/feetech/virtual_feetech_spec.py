"""Description of one virtual Feetech servo, and its factory settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind_drivers.virtual.hinge import Hinge

FIRMWARE: Mapping[str, tuple[int, int, int]] = {
    "sts": (3, 10, 0),
    "smbl": (2, 45, 0),
    "hls": (3, 43, 0),
    "scs": (0, 20, 1),
}
DEFAULTS: dict[str, int] = {
    "baud_rate": 0,
    "status_return_level": 1,
    "max_position_limit": 4095,
    "temperature_limit": 70,
    "max_voltage_limit": 140,
    "min_voltage_limit": 40,
    "max_torque": 1000,
    "phase": 12,
    "shutdown": 44,
    "led_alarm": 47,
    "position_p_gain": 32,
    "position_d_gain": 32,
    "min_start_force": 16,
    "dead_zone_cw": 1,
    "dead_zone_ccw": 1,
    "protection_current": 500,
    "angular_resolution": 1,
    "protective_torque": 20,
    "protection_time": 200,
    "overload_torque": 80,
    "over_current_time": 200,
}


@dataclass(frozen=True, slots=True)
class FeetechServoSpec:
    """One servo: id, model, and the EPROM settings that are not factory ones.

    `firmware`: major, minor, END; None: that of its map. `sync_read`: it answers sync reads. `volts`: its
    supply. `goal_arms`: a goal switches torque on. `boots_armed`: torque is on after power-up. `latches`:
    only power-off ends an overload. `hinge`: its joint.
    """

    id: int
    model: str = "STS3215"
    settings: Mapping[str, int] = field(default_factory=dict)
    firmware: tuple[int, int, int] | None = None
    sync_read: bool = True
    volts: float = 7.4
    goal_arms: bool = False
    boots_armed: bool = False
    latches: bool = False
    hinge: Hinge | None = None
