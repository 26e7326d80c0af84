"""Access, sign, range and default of each register, which the vendor's tables lack. Own data, pure.

Source: the e-manual page of each model. Rules that a whole series shares are here; those that differ from
model to model are in `factory_defaults.py`. Keys are snake case. A default that the page leaves open is None.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

from twind_drivers.dynamixel.dynamixel_models import base, facts
from twind_drivers.dynamixel.error_codes import BITS_BY_CODE
from twind_drivers.dynamixel.factory_defaults import FACTORY, X_SERIES, Y_SERIES, FactoryDefaults


@dataclass(frozen=True, slots=True)
class RegisterRule:
    """Access, sign, range and default of one register, raw units.

    `limit` names the register that bounds its magnitude further (error 6).
    """

    writable: bool = True
    signed: bool = False
    lower: int | None = None  # None: what its size holds
    upper: int | None = None
    default: int | None = 0  # after power-up (RAM) or factory reset (EEPROM); None: not known here
    limit: str | None = None
    values: frozenset[int] | None = None  # the only permitted ones; None: all in the range
    codes: tuple[int, ...] | None = None  # of a register with error codes: the bits of each code


READ_ONLY = RegisterRule(writable=False)
SIGNED_READ_ONLY = RegisterRule(writable=False, signed=True)
GAIN = RegisterRule(lower=0, upper=16383, default=None)
ANY = RegisterRule(default=None)
GAINS = ("velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain")
FEEDS = ("feedforward_2nd_gain", "feedforward_1st_gain")
REPORTS = ("present_", "error_code", "controller_state")  # registers that only report, of any model

X: Mapping[str, RegisterRule] = {
    "model_number": READ_ONLY,
    "model_information": READ_ONLY,
    "firmware_version": READ_ONLY,
    "id": RegisterRule(lower=0, upper=252, default=1),
    "baud_rate": RegisterRule(lower=0, upper=7, default=1),
    "drive_mode": RegisterRule(lower=0, upper=15),
    "operating_mode": RegisterRule(lower=0, upper=16, default=3),
    "secondary_shadow_id": RegisterRule(lower=0, upper=255, default=255),
    "secondary_id": RegisterRule(lower=0, upper=255, default=255),
    "protocol_type": RegisterRule(lower=1, upper=2, default=2),
    "homing_offset": RegisterRule(signed=True, lower=-1_044_479, upper=1_044_479),
    "external_port_mode": RegisterRule(lower=0, upper=3, default=3),
    "startup_configuration": RegisterRule(lower=0, upper=3),
    "torque_enable": RegisterRule(lower=0, upper=1),
    "led": RegisterRule(lower=0, upper=1),
    "status_return_level": RegisterRule(lower=0, upper=2, default=2),
    "registered_instruction": READ_ONLY,
    "hardware_error_status": READ_ONLY,
    **dict.fromkeys(GAINS, GAIN),
    **dict.fromkeys(FEEDS, replace(GAIN, default=0)),
    "bus_watchdog": RegisterRule(lower=0, upper=127),  # x 20 ms; reads 255 once it has tripped
    "goal_current": RegisterRule(signed=True, default=None, limit="current_limit"),
    "goal_velocity": RegisterRule(signed=True, default=0, limit="velocity_limit"),
    "profile_acceleration": RegisterRule(lower=0, upper=32767),
    "profile_velocity": RegisterRule(lower=0, upper=32767),
    "goal_position": RegisterRule(signed=True, lower=-1_048_575, upper=1_048_575),
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
    "external_port_data": RegisterRule(lower=0, upper=4095, default=None),
    "indirect_address": RegisterRule(lower=64, upper=661, default=None),
    "indirect_data": RegisterRule(lower=0, upper=255),
}

SMALL: Mapping[str, RegisterRule] = {  # X330: no 4.5 Mbit/s; RC protocols 20..22 beside Protocol 2
    **X,
    "baud_rate": RegisterRule(lower=0, upper=6, default=1),
    "protocol_type": RegisterRule(lower=2, upper=22, default=2, values=frozenset({2, 20, 21, 22})),
    "indirect_address": RegisterRule(lower=64, upper=227, default=None),
}

P: Mapping[str, RegisterRule] = {  # and PRO -R(A), RH-P12-RN(A)
    **X,
    "baud_rate": RegisterRule(lower=0, upper=9, default=1),
    "drive_mode": RegisterRule(lower=0, upper=13),
    "protocol_type": RegisterRule(lower=2, upper=10, default=2, values=frozenset({2, 10})),  # 10: Modbus
    "homing_offset": RegisterRule(signed=True),
    **dict.fromkeys(("led_red", "led_green", "led_blue"), RegisterRule(lower=0, upper=255)),
    **dict.fromkeys(GAINS, replace(GAIN, upper=32767)),
    "goal_position": RegisterRule(signed=True),
    "profile_acceleration": RegisterRule(lower=0, default=None, limit="acceleration_limit"),
    "profile_velocity": RegisterRule(lower=0, default=None, limit="velocity_limit"),
    "external_port_data": RegisterRule(lower=0, upper=4095),
    "indirect_address": RegisterRule(lower=512, upper=1023, default=None),
}

Y_GAIN = RegisterRule(lower=0, upper=2**31 - 1)
Y_FILTER = RegisterRule(lower=0, upper=32767)
Y_PERCENT = RegisterRule(lower=0, upper=100)
Y_TIMES = ("brake_delay", "goal_update_delay", "overexcitation_time")
Y_FILTERS = ("position_limit_threshold", "present_velocity_lpf_frequency", "goal_current_lpf_frequency")
Y_ALIASES = {"baud_rate_bus": "baud_rate", "motor_temperature_limit": "temperature_limit"}
Y: Mapping[str, RegisterRule] = {
    **P,
    "baud_rate": RegisterRule(lower=0, upper=9, default=1),
    "drive_mode": RegisterRule(lower=0, upper=77),
    "startup_configuration": RegisterRule(lower=0, upper=1),
    "protocol_type": RegisterRule(lower=2, upper=2, default=2),
    "hardware_error_status": RegisterRule(writable=False, codes=BITS_BY_CODE),
    **dict.fromkeys((*GAINS, "velocity_ff_gain", "position_ff_gain"), Y_GAIN),
    "electronic_gearratio_denominator": RegisterRule(lower=1, upper=1_045_576, default=1),
    "indirect_address": RegisterRule(lower=0, upper=919, default=None),
    "inverter_temperature_limit": replace(Y_PERCENT, default=80),
    "following_error_threshold": Y_GAIN,
    **dict.fromkeys((*Y_TIMES, *Y_FILTERS), Y_FILTER),
    "safe_stop_time": replace(Y_FILTER, default=200),
    "overexcitation_voltage": replace(Y_PERCENT, default=100),
    "normal_excitation_voltage": Y_PERCENT,
    **dict.fromkeys(("position_ff_lpf_time", "velocity_ff_lpf_time"), RegisterRule(lower=0, upper=512)),
    "hybrid_save": RegisterRule(lower=0, upper=2),
    "profile_acceleration_time": RegisterRule(lower=0, upper=262_144, default=400),
    "profile_time": RegisterRule(lower=0, upper=524_288, default=800),
    **dict.fromkeys(("pwm_offset", "current_offset", "velocity_offset"), RegisterRule(signed=True)),
    **dict.fromkeys(("velocity_trajectory", "position_trajectory"), SIGNED_READ_ONLY),
}


def rule(stem: str, key: str) -> RegisterRule:
    """Return the rule of register `key` of the model of table `stem` ("xm430_w350"). Unknown: any value."""
    key = _numberless(key)
    unknown = READ_ONLY if key.startswith(REPORTS) else ANY
    if base(stem) in FACTORY:
        return _rules(base(stem)).get(key, unknown)
    # XL320: Protocol 2 on the old layout: magnitudes with a direction bit, no two's complement
    return replace(ANY, writable=X.get(key, unknown).writable)


def _numberless(key: str) -> str:
    """Return the key that a row of registers shares: "indirect_data" for "indirect_data_12". One rule."""
    front, _, number = key.rpartition("_")
    return front if number.isdecimal() else key


@cache
def _rules(stem: str) -> Mapping[str, RegisterRule]:
    """Return the rules of one model by register: those of its series, changed by its own page."""
    made = FACTORY[stem]
    series = SMALL if made.slope is not None else X if stem in X_SERIES else Y if stem in Y_SERIES else P
    found = {**series, **_limits(made, 885 if series in (X, SMALL) else 1000 if series is Y else 2009)}
    found["operating_mode"] = replace(found["operating_mode"], values=facts(stem).modes)
    for key, default in zip(GAINS, made.gains, strict=True):
        found[key] = replace(series[key], default=default)
    feed = None if None in made.gains else 0  # the pages leave both open, or neither
    found.update(dict.fromkeys(FEEDS, replace(series[GAINS[0]], default=feed)))
    if series is Y:
        found["electronic_gearratio_numerator"] = RegisterRule(
            lower=1, upper=1_045_576, default=facts(stem).gear
        )
        for key in ("goal_pwm", "goal_current"):
            found[key] = replace(found[key], default=0)
        for kind in ("velocity", "acceleration"):
            default = found[f"{kind}_limit"].default
            found[f"profile_{kind}"] = replace(found[f"profile_{kind}"], default=default)
        found["in_position_threshold"] = found["moving_threshold"]
        found.update({key: found[other] for key, other in Y_ALIASES.items()})
    if series is P:  # no page states the goals after power-up
        for key in ("goal_pwm", "goal_velocity", "goal_current"):
            found[key] = replace(found[key], default=None)
    if stem == "rh_p12_rn":  # the gripper
        ends = RegisterRule(signed=True, lower=0, upper=made.position[1])
        found.update(homing_offset=ends, goal_position=ends)
        found["goal_current"] = replace(found["goal_current"], default=0)
    return MappingProxyType(found)


def _limits(made: FactoryDefaults, pwm: int) -> dict[str, RegisterRule]:
    """Return the rules of registers whose range or default is specific to the model."""
    low, high = made.position
    volts = RegisterRule(lower=made.volts[0], upper=made.volts[1])
    least = made.volts[0] if made.volts_least is None else made.volts_least
    speed = made.velocity_most
    current = made.current
    found = {
        "return_delay_time": RegisterRule(lower=0, upper=made.delay_most, default=250),
        "operating_mode": RegisterRule(lower=0, upper=16, default=made.mode),
        "moving_threshold": RegisterRule(lower=0, upper=made.threshold_most or speed, default=made.threshold),
        "temperature_limit": RegisterRule(lower=0, upper=100, default=made.temperature),
        "max_voltage_limit": replace(volts, default=made.volts_most or made.volts[1]),
        "min_voltage_limit": replace(volts, default=least),
        "pwm_limit": RegisterRule(lower=0, upper=pwm, default=pwm),
        "velocity_limit": RegisterRule(lower=0, upper=speed, default=made.velocity),
        "max_position_limit": RegisterRule(
            signed=True, lower=low, upper=high, default=made.position_limits[1]
        ),
        "min_position_limit": RegisterRule(
            signed=True, lower=low, upper=high, default=made.position_limits[0]
        ),
        "shutdown": RegisterRule(lower=0, upper=made.shutdown_most, default=made.shutdown),
        "goal_velocity": RegisterRule(
            signed=True, lower=-speed, upper=speed, default=0, limit="velocity_limit"
        ),
        "goal_pwm": RegisterRule(signed=True, lower=-pwm, upper=pwm, default=pwm, limit="pwm_limit"),
    }
    if current is not None:
        found["current_limit"] = RegisterRule(lower=0, upper=current, default=current)
        found["goal_current"] = RegisterRule(
            signed=True, lower=-current, upper=current, default=current, limit="current_limit"
        )
    if made.acceleration is not None:
        delivered, most = made.acceleration
        found["acceleration_limit"] = RegisterRule(lower=0, upper=most, default=delivered)
    if made.slope is not None:
        found["pwm_slope"] = RegisterRule(lower=1, upper=255, default=made.slope)
    return found
