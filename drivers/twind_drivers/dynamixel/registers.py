"""What the vendor's tables do not say: access, sign, range and default of each register. Ours, pure.

Source: e-manual control table pages of XM430-W350 and XL330-M288. Keys are snake case. Of models whose page
we have not checked, the range is the widest of the X series and the default is unknown (None).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Rule:
    """Of one register, raw units. `limit` names the register that bounds its magnitude further (error 6)."""

    writable: bool = True
    signed: bool = False
    lower: int | None = None  # None: what its size holds
    upper: int | None = None
    default: int | None = 0  # after power-up (RAM) or factory reset (EEPROM); None: not known here
    limit: str | None = None


READ_ONLY = Rule(writable=False)
SIGNED_READ_ONLY = Rule(writable=False, signed=True)
GAIN = Rule(lower=0, upper=16383, default=None)
ANY = Rule(default=None)

X: Mapping[str, Rule] = {
    "model_number": READ_ONLY,
    "model_information": READ_ONLY,
    "firmware_version": READ_ONLY,
    "id": Rule(lower=0, upper=252, default=1),
    "baud_rate": Rule(lower=0, upper=7, default=1),
    "return_delay_time": Rule(lower=0, upper=254, default=250),
    "drive_mode": Rule(lower=0, upper=15),
    "operating_mode": Rule(lower=0, upper=16, default=3),
    "secondary_shadow_id": Rule(lower=0, upper=255, default=255),
    "secondary_id": Rule(lower=0, upper=255, default=255),
    "protocol_type": Rule(lower=1, upper=2, default=2),
    "homing_offset": Rule(signed=True, lower=-1_044_479, upper=1_044_479),
    "moving_threshold": Rule(lower=0, upper=1023, default=10),
    "temperature_limit": Rule(lower=0, upper=100, default=None),
    "max_voltage_limit": Rule(lower=31, upper=160, default=None),
    "min_voltage_limit": Rule(lower=31, upper=160, default=None),
    "pwm_limit": Rule(lower=0, upper=885, default=885),
    "current_limit": Rule(lower=0, upper=2047, default=None),
    "velocity_limit": Rule(lower=0, upper=2047, default=None),
    "max_position_limit": Rule(signed=True, lower=0, upper=4095, default=4095),
    "min_position_limit": Rule(signed=True, lower=0, upper=4095, default=0),
    "startup_configuration": Rule(lower=0, upper=3),
    "pwm_slope": Rule(lower=1, upper=255, default=140),
    "shutdown": Rule(lower=0, upper=63, default=52),
    "torque_enable": Rule(lower=0, upper=1),
    "led": Rule(lower=0, upper=1),
    "status_return_level": Rule(lower=0, upper=2, default=2),
    "registered_instruction": READ_ONLY,
    "hardware_error_status": READ_ONLY,
    "velocity_i_gain": GAIN,
    "velocity_p_gain": GAIN,
    "position_d_gain": GAIN,
    "position_i_gain": GAIN,
    "position_p_gain": GAIN,
    "feedforward_2nd_gain": replace(GAIN, default=0),
    "feedforward_1st_gain": replace(GAIN, default=0),
    "bus_watchdog": Rule(lower=0, upper=127),  # x 20 ms; reads 255 once it has tripped
    "goal_pwm": Rule(signed=True, lower=-885, upper=885, default=885, limit="pwm_limit"),
    "goal_current": Rule(signed=True, default=None, limit="current_limit"),
    "goal_velocity": Rule(signed=True, default=0, limit="velocity_limit"),
    "profile_acceleration": Rule(lower=0, upper=32767),
    "profile_velocity": Rule(lower=0, upper=32767),
    "goal_position": Rule(signed=True, lower=-1_048_575, upper=1_048_575),
    "realtime_tick": READ_ONLY,
    "moving": READ_ONLY,
    "moving_status": READ_ONLY,
    "present_pwm": SIGNED_READ_ONLY,
    "present_current": SIGNED_READ_ONLY,
    "present_load": SIGNED_READ_ONLY,
    "present_velocity": SIGNED_READ_ONLY,
    "present_position": SIGNED_READ_ONLY,
    "velocity_trajectory": SIGNED_READ_ONLY,
    "position_trajectory": SIGNED_READ_ONLY,
    "present_input_voltage": READ_ONLY,
    "present_temperature": READ_ONLY,
    "backup_ready": READ_ONLY,
}

XM430: Mapping[str, Rule] = {
    "temperature_limit": Rule(lower=0, upper=100, default=80),
    "max_voltage_limit": Rule(lower=95, upper=160, default=160),
    "min_voltage_limit": Rule(lower=95, upper=160, default=95),
    "current_limit": Rule(lower=0, upper=1193, default=1193),
    "velocity_limit": Rule(lower=0, upper=1023, default=200),
    "velocity_i_gain": replace(GAIN, default=1920),
    "velocity_p_gain": replace(GAIN, default=100),
    "position_d_gain": replace(GAIN, default=0),
    "position_i_gain": replace(GAIN, default=0),
    "position_p_gain": replace(GAIN, default=800),
    "goal_current": Rule(signed=True, lower=-1193, upper=1193, default=1193, limit="current_limit"),
    "goal_velocity": Rule(signed=True, lower=-1023, upper=1023, default=0, limit="velocity_limit"),
}

XL330: Mapping[str, Rule] = {
    "baud_rate": Rule(lower=0, upper=6, default=1),
    "temperature_limit": Rule(lower=0, upper=100, default=70),
    "max_voltage_limit": Rule(lower=31, upper=70, default=70),
    "min_voltage_limit": Rule(lower=31, upper=70, default=35),
    "current_limit": Rule(lower=0, upper=1750, default=1750),
    "velocity_limit": Rule(lower=0, upper=2047, default=445),
    "shutdown": Rule(lower=0, upper=63, default=53),
    "velocity_i_gain": replace(GAIN, default=1600),
    "velocity_p_gain": replace(GAIN, default=180),
    "position_d_gain": replace(GAIN, default=0),
    "position_i_gain": replace(GAIN, default=0),
    "position_p_gain": replace(GAIN, default=400),
    "goal_current": Rule(signed=True, lower=-1750, upper=1750, default=1750, limit="current_limit"),
    "goal_velocity": Rule(signed=True, lower=-2047, upper=2047, default=0, limit="velocity_limit"),
}

FAMILIES: Mapping[str, Mapping[str, Rule]] = {"xm430_w350": XM430, "xl330_m288": XL330}

OPERATING_MODES = frozenset({0, 1, 3, 4, 5, 16})


def rule(stem: str, key: str) -> Rule:
    """The rule of register `key` of the model whose table is `stem` ("xm430_w350"). Unknown: any value."""
    family = FAMILIES.get(stem.removesuffix("_fw52"), {})
    found = family.get(key) or X.get(key, ANY)
    if stem == "xl320":  # Protocol 2 on the old layout: magnitudes with a direction bit, no two's complement
        return replace(ANY, writable=found.writable)
    if stem.startswith(("x", "2x")):
        return found
    return replace(found, lower=None, upper=None, default=None)  # P, MX, Y: access and sign are the same
