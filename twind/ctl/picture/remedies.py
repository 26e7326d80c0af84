"""What to do about a latched fault, in a line; docs/safety.md says more of each code."""

from collections.abc import Mapping

AGAIN = "twindctl disarm, twindctl reset, twindctl arm"

REMEDIES: Mapping[str, str] = {
    "ESTOP": "find out why it was stopped, then twindctl reset",
    "FAULT_LATCHED": "remedy what is latched, twindctl disarm, twindctl reset",
    "ESTOP_LATCHED": "find out why it was stopped, then twindctl reset",
    "CALIB_MISSING": "give --calibration FILE, or calibrate: twindctl calibrate sweep",
    "CALIB_MISMATCH": "twindctl doctor says what differs; restore it or calibrate anew",
    "HW_DISCONNECTED": "its cable and power; twindctl scan",
    "LATENCY_WARN": "twindctl doctor: latency timer, load of this machine",
    "LATENCY_BLOCK": "twindctl doctor: latency timer, load of this machine",
    "THERMAL_HEADROOM": "let it cool",
    "VOLTAGE_LOW": "charge, or another supply",
    "LOOP_LATE": "less load on this machine; twindctl doctor",
    "LEASE_LOST": "renew the lease, or follow the motion with `more`",
    "STREAM_STALE": "send setpoints more often",
    "STATE_STALE": "its cable, power and id",
    "BUS_ERRORS": "wiring, termination, power and baud rate of the bus; if virtual: load of this machine",
    "RX_SHAPE": "wiring, a second master, two servos with one id",
    "FOREIGN_TRAFFIC": "disconnect the other master; then twindctl disarm, twindctl reset",
    "SERVO_ALERT": "find the cause, twindctl disarm, twindctl reboot BUS ID",
    "TORQUE_MISMATCH": f"its hardware error (notes of the joint); {AGAIN}",
    "SERVO_REBOOTED": f"its power and cable; {AGAIN}",
    "WATCHDOG_TRIPPED": f"find out what stopped the loop; {AGAIN}",
    "SENSE_JUMP": "horn, gear and cable; calibrate again",
    "OUT_OF_LIMIT": "twindctl disarm, move it inside by hand, check its calibration",
    "FOLLOW_ERR": f"what blocks it, its load and gains; {AGAIN}",
    "SENSE_FROZEN": f"its encoder and cable; {AGAIN}",
    "OVERSPEED": "what drives it; its gains",
    "OVERCURRENT": f"what it pushes against; let it rest; {AGAIN}",
    "OVERTEMP": "let it cool; less load; then twindctl reset",
    "VOLTAGE": "battery, supply, cables; then twindctl reset",
    "LOOKAHEAD_COLLISION": "another way: the message names the pair",
    "STEP_LIMIT": "a bug of ours: report it",
    "WIRE_CLAMP": "a bug of ours: report it",
    "TX_BACKLOG": f"replug the adapter, or use another; {AGAIN}",
    "CAN_BUS_STATE": f"power, termination and bit rate of the bus; {AGAIN}",
    "MIRROR_DRIFT": "a contact that the message names; calibration, load, gains",
    "INTERNAL": "a bug of ours: report it with twindctl dump and the log",
    "TIME_GAP": f"find out what stopped the machine; {AGAIN}",
    "SOCKETS_GONE": "what the message names; `twindctl estop` still lowers the robot",
    "PORT_LOST": "plug it in; twindctl disarm, twindctl reset",
    "PORT_UNAVAILABLE": "the message says why; it is tried again",
    "DEVICE_MISSING": "its power, cable, id and baud rate; twindctl scan",
    "DEVICE_MISMATCH": "twindctl doctor --fix, or twindctl adopt",
    "ARM_FAILED": "what the message names, then twindctl arm",
    "STOP_NOT_FOUND": "what the message names; calibration/README.md",
    "TORQUE_INHERITED": "twindctl arm takes it over, twindctl disarm lowers the robot",
    "CONFIG_REFUSED": "mend the file where the message points, then twindctl reload",
    "PATH_TOLERANCE": "a slower motion, or what is in the way",
    "GOAL_TOLERANCE": "a slower motion, or what is in the way",
}


def remedy(code: str) -> str:
    """For a code that is newer than this program: where to read."""
    return REMEDIES.get(code, f"docs/safety.md says what to do about {code}")
