"""Register maps of Feetech servos, and which of them a firmware has. Pure.

The map follows from the firmware bytes, never from the model or the packets: register 48 is the torque limit
of an STS and the lock of an SCS. A firmware without a map here is read only.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from twind_drivers.half_duplex.register_table import MappedRegister, RegisterTable, parse_registers

# Rates by the code in register 6. Sources differ on codes 5 to 7: 57600, 38400 and 19200 by lerobot.
BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
EPROM_END = 40  # the first RAM register
IDENTITY = (0, 5)  # address and size: firmware major, minor, END, model major, minor
GOAL = (42, 2)  # address and size of the goal position, the same in all maps
STATE_SIZE = 31  # bytes from register 40 to 70

# name, address, size, sign bit (- none), least, most; least = most: read only
_STS = """
firmware_major 0 1 - 0 0
firmware_minor 1 1 - 0 0
end 2 1 - 0 0
model_number 3 2 - 0 0
id 5 1 - 0 253
baud_rate 6 1 - 0 7
return_delay_time 7 1 - 0 254
status_return_level 8 1 - 0 1
min_position_limit 9 2 15 -32766 32766
max_position_limit 11 2 15 -32766 32766
temperature_limit 13 1 - 0 100
max_voltage_limit 14 1 - 0 254
min_voltage_limit 15 1 - 0 254
max_torque 16 2 - 0 1000
phase 18 1 - 0 255
shutdown 19 1 - 0 255
led_alarm 20 1 - 0 255
position_p_gain 21 1 - 0 254
position_d_gain 22 1 - 0 254
position_i_gain 23 1 - 0 254
min_start_force 24 1 - 0 254
dead_zone_cw 26 1 - 0 32
dead_zone_ccw 27 1 - 0 32
protection_current 28 2 - 0 2047
angular_resolution 30 1 - 1 128
homing_offset 31 2 11 -2047 2047
operating_mode 33 1 - 0 3
protective_torque 34 1 - 0 100
protection_time 35 1 - 0 254
overload_torque 36 1 - 0 100
over_current_time 38 1 - 0 254
torque_enable 40 1 - 0 128
acceleration 41 1 - 0 254
goal_position 42 2 15 -32766 32766
goal_time 44 2 - 0 1000
goal_velocity 46 2 15 -32766 32766
torque_limit 48 2 - 0 1000
lock 55 1 - 0 1
present_position 56 2 15 0 0
present_velocity 58 2 15 0 0
present_load 60 2 10 0 0
present_input_voltage 62 1 - 0 0
present_temperature 63 1 - 0 0
hardware_error_status 65 1 - 0 0
moving 66 1 - 0 0
position_trajectory 67 2 15 0 0
present_current 69 2 15 0 0
"""
_HLS = """
goal_torque 44 2 15 -2047 2047
homing_offset 31 2 15 -4095 4095
"""
_SCS = """
min_position_limit 9 2 - 0 1023
max_position_limit 11 2 - 0 1023
goal_position 42 2 - 0 1023
goal_time 44 2 - 0 9999
goal_velocity 46 2 - 0 9999
lock 48 1 - 0 1
protective_torque 37 1 - 0 100
protection_time 38 1 - 0 254
overload_torque 39 1 - 0 100
present_position 56 2 - 0 0
"""
_NOT_SCS = (
    "angular_resolution", "homing_offset", "operating_mode", "over_current_time", "acceleration",
    "torque_limit", "position_trajectory", "present_current", "phase", "protection_current",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RegisterMap(RegisterTable):
    """Registers of one kind of servo. `driven`: its torque may be switched on by this driver."""

    name: str
    big_endian: bool
    sync_read: bool  # the kind has it; old firmware of the kind may lack it
    driven: bool
    turn: float  # counts per turn


def _map(name: str, registers: Mapping[str, MappedRegister], **more: Any) -> RegisterMap:
    return RegisterMap(f"a Feetech {name.upper()}", registers, name, **more)


@cache
def register_map(name: str) -> RegisterMap:
    """Return the map `sts`, `smbl`, `hls`, `scs`, `scs2`, `smcl` or `unknown`. Raises KeyError."""
    sts = parse_registers(_STS, EPROM_END)
    of_scs = sts | parse_registers(_SCS, EPROM_END)
    scs = {key: replace(each, order="big") for key, each in of_scs.items() if key not in _NOT_SCS}
    hls = {
        key: each
        for key, each in (sts | parse_registers(_HLS, EPROM_END)).items()
        if key not in ("goal_time", "overload_torque", "return_delay_time")
    }
    known = {key: sts[key] for key in ("firmware_major", "firmware_minor", "end", "model_number", "id")}
    maps = (
        _map("sts", sts, big_endian=False, sync_read=True, driven=True, turn=4096.0),
        _map("smbl", sts, big_endian=False, sync_read=True, driven=True, turn=4096.0),
        _map("hls", hls, big_endian=False, sync_read=True, driven=True, turn=4096.0),
        _map("scs", scs, big_endian=True, sync_read=False, driven=True, turn=1024 * 1.2),
        _map("scs2", scs, big_endian=True, sync_read=False, driven=False, turn=1024 * 1.2),
        _map("smcl", known, big_endian=False, sync_read=False, driven=False, turn=4096.0),
        _map("unknown", known, big_endian=False, sync_read=False, driven=False, turn=4096.0),
    )
    return {each.name: each for each in maps}[name]


def map_of_firmware(major: int, minor: int, end: int) -> RegisterMap:
    """Return the map of a firmware as the vendor's tool chooses it; `unknown` for any other."""
    rows = (
        ("scs", 0, range(40), 1),
        ("smcl", 1, range(40), 0),
        ("smbl", 2, range(40, 70), 0),
        ("sts", 3, range(40), 0),
        ("scs2", 3, range(20, 40), 1),
        ("hls", 3, range(40, 60), 0),
    )
    for name, own, minors, order in rows:
        if (major, end) == (own, order) and minor in minors:
            return register_map(name)
    return register_map("unknown")
