"""Description of one virtual servo of Protocol 1.0, and its factory settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind_drivers.dynamixel1.dynamixel1_models import Dynamixel1Model
from twind_drivers.virtual.hinge import Hinge

FIRMWARE = {"ax": 24, "mx": 36, "mx_current": 36}  # as delivered before Protocol 2.0
DEFAULTS: Mapping[str, int] = {
    "baud_rate": 1,
    "return_delay_time": 250,
    "min_voltage_limit": 60,
    "max_voltage_limit": 160,
    "max_torque": 1023,
    "status_return_level": 2,
    "led_alarm": 36,
    "shutdown": 36,
    "resolution_divider": 1,
}
RAM: Mapping[str, int] = {
    "cw_compliance_margin": 1,
    "ccw_compliance_margin": 1,
    "cw_compliance_slope": 32,
    "ccw_compliance_slope": 32,
    "position_p_gain": 32,
    "punch": 32,
}


@dataclass(frozen=True, slots=True)
class Dynamixel1ServoSpec:
    """One servo: id, model, and the EEPROM settings that are not factory ones.

    `firmware`: None: one before Protocol 2.0. `bulk_read`: it answers bulk reads, if its model does. `volts`:
    its supply; None: that of its page. `goal_arms`: a goal switches torque on. `hinge`: its joint.
    """

    id: int
    model: str = "AX-12A"
    settings: Mapping[str, int] = field(default_factory=dict)
    firmware: int | None = None
    bulk_read: bool = True
    volts: float | None = None
    goal_arms: bool = False
    hinge: Hinge | None = None


def factory_settings(model: Dynamixel1Model) -> dict[str, int]:
    """Return the EEPROM content of a new servo, at 1 Mbaud, with the voltage range of its page."""
    limits = {"max_position_limit": model.counts - 1, "temperature_limit": round(model.hottest)}
    volts = {12.0: 160, 11.1: 140}.get(model.volts, 240 if model.counts == 4096 else 190)
    return {**DEFAULTS, **limits, "max_voltage_limit": volts}
