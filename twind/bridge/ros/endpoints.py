"""The one table: which topics and services there are, of which type and quality. Standard library, 3.10.

State is RELIABLE KEEP_LAST 10: a BEST_EFFORT writer does not match RELIABLE readers, which most are.
"""

from __future__ import annotations

from dataclasses import dataclass

from twind.ros import (
    DIAGNOSTIC_ARRAY,
    FLOATS,
    IMU,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    SET_BOOL,
    STRING,
    TRIGGER,
)

NODE = "twind"  # the node's name; no namespace
MODES = ("sim", "mirror", "live")


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic. `out`: we write it, else we read it. All are RELIABLE, KEEP_LAST `depth`."""

    name: str
    kind: str
    out: bool
    depth: int = 10
    latched: bool = False  # TRANSIENT_LOCAL: who comes later has the last one


@dataclass(frozen=True, slots=True)
class Service:
    """One service; only where a back end truly serves them."""

    name: str
    kind: str = TRIGGER


HW_JOINTS = Topic("/hw/joint_states", JOINT_STATE, out=True)
SIM_JOINTS = Topic("/sim/joint_states", JOINT_STATE, out=True)
# Another name in mirror: who feeds /sim/joint_states elsewhere must not be fed by it.
MIRRORED_JOINTS = Topic("/sim/joint_states_mirrored", JOINT_STATE, out=True)
JOINTS = Topic("/joint_states", JOINT_STATE, out=True)
INERTIAL = Topic("/imu", IMU, out=True)
ACCEPTED = Topic("/hw/joint_trajectory", JOINT_TRAJECTORY, out=True)
LATENCY = Topic("/bridge/latency", FLOATS, out=True)
STATUS = Topic("/bridge/status", STRING, out=True, depth=1, latched=True)
RESULTS = Topic("/bridge/results", STRING, out=True)
DIAGNOSTICS = Topic("/diagnostics", DIAGNOSTIC_ARRAY, out=True)

TRAJECTORY = Topic("/cmd/joint_trajectory", JOINT_TRAJECTORY, out=False)
SET_MODE = Topic("/bridge/set_mode_cmd", STRING, out=False)
STOP = Topic("/bridge/stop_cmd", STRING, out=False)
E_STOP = Topic("/bridge/estop_cmd", STRING, out=False)

TOPICS = (
    *(HW_JOINTS, SIM_JOINTS, MIRRORED_JOINTS, JOINTS, INERTIAL),
    *(ACCEPTED, LATENCY, STATUS, RESULTS, DIAGNOSTICS),
    *(TRAJECTORY, SET_MODE, STOP, E_STOP),
)

GET_STATUS = Service("/bridge/get_status")
SET_LIVE = Service("/bridge/set_mode", SET_BOOL)  # true: live, false: mirror
TO_MODE = {mode: Service(f"/bridge/set_mode_{mode}") for mode in MODES}
TO_STOP = Service("/bridge/stop")
TO_E_STOP = Service("/bridge/estop")

# Ours and that of any other bridge in the graph, read: not of the robot, and so not in the table.
NEIGHBOURS = Topic(STATUS.name, STRING, out=False, latched=True)

SERVICES = (GET_STATUS, SET_LIVE, *TO_MODE.values(), TO_STOP, TO_E_STOP)
