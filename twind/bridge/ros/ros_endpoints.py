"""Table of topics and services with their types and quality. Standard library, 3.10.

State is RELIABLE KEEP_LAST 10: a BEST_EFFORT writer does not match RELIABLE readers, which most are.
Names are those without a namespace; `ros_names` adds it.
"""

from __future__ import annotations

from dataclasses import dataclass

from twind.ros import (
    CLOCK,
    DIAGNOSTIC_ARRAY,
    DYNAMIC_JOINT_STATE,
    FLOAT,
    FLOATS,
    IMU,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    LOG,
    SET_BOOL,
    STRING,
    TRANSFORMS,
    TRIGGER,
)

MODES = ("sim", "mirror", "live")


@dataclass(frozen=True, slots=True)
class RosTopic:
    """Topic of the bridge. `out`: it is written, else read. All are RELIABLE, KEEP_LAST `depth`."""

    name: str
    kind: str
    out: bool
    depth: int = 10
    latched: bool = False  # TRANSIENT_LOCAL: later readers receive the last message
    optional: bool = False  # left out where the package of its type is not installed


@dataclass(frozen=True, slots=True)
class RosService:
    """One service; only where a back end truly serves them."""

    name: str
    kind: str = TRIGGER


HW_JOINTS = RosTopic("/hw/joint_states", JOINT_STATE, out=True)
SIM_JOINTS = RosTopic("/sim/joint_states", JOINT_STATE, out=True)
# Another name in mirror: readers of the real robot's states must not receive those of a simulation.
MIRRORED_JOINTS = RosTopic("/sim/joint_states_mirrored", JOINT_STATE, out=True)
JOINTS = RosTopic("/joint_states", JOINT_STATE, out=True)
INERTIAL = RosTopic("/imu", IMU, out=True)
ACCEPTED = RosTopic("/hw/joint_trajectory", JOINT_TRAJECTORY, out=True)
DYNAMIC_JOINTS = RosTopic("/dynamic_joint_states", DYNAMIC_JOINT_STATE, out=True, optional=True)
SIM_TIME = RosTopic("/clock", CLOCK, out=True, optional=True)
DESCRIPTION = RosTopic("/robot_description", STRING, out=True, depth=1, latched=True)
MOVING_FRAMES = RosTopic("/tf", TRANSFORMS, out=True, optional=True)
FIXED_FRAMES = RosTopic("/tf_static", TRANSFORMS, out=True, depth=1, latched=True, optional=True)
LATENCY = RosTopic("/bridge/latency", FLOAT, out=True)
LATENCIES = RosTopic("/bridge/latencies", FLOATS, out=True)
STATUS = RosTopic("/bridge/status", STRING, out=True, depth=1, latched=True)
RESULTS = RosTopic("/bridge/results", STRING, out=True)
DIAGNOSTICS = RosTopic("/diagnostics", DIAGNOSTIC_ARRAY, out=True)
ROSOUT = RosTopic("/rosout", LOG, out=True, depth=1000, latched=True)  # as rcl writes it

TRAJECTORY = RosTopic("/cmd/joint_trajectory", JOINT_TRAJECTORY, out=False)
SET_MODE = RosTopic("/bridge/set_mode_cmd", STRING, out=False)
STOP = RosTopic("/bridge/stop_cmd", STRING, out=False)
E_STOP = RosTopic("/bridge/estop_cmd", STRING, out=False)

TOPICS = (
    *(HW_JOINTS, SIM_JOINTS, MIRRORED_JOINTS, JOINTS, INERTIAL),
    *(DYNAMIC_JOINTS, SIM_TIME, DESCRIPTION, MOVING_FRAMES, FIXED_FRAMES),
    *(ACCEPTED, LATENCY, LATENCIES, STATUS, RESULTS, DIAGNOSTICS, ROSOUT),
    *(TRAJECTORY, SET_MODE, STOP, E_STOP),
)

# What robot_state_publisher writes too.
DESCRIBED = (DESCRIPTION, MOVING_FRAMES, FIXED_FRAMES)

GET_STATUS = RosService("/bridge/get_status")
SET_LIVE = RosService("/bridge/set_mode", SET_BOOL)  # true: live, false: mirror
TO_MODE = {mode: RosService(f"/bridge/set_mode_{mode}") for mode in MODES}
TO_STOP = RosService("/bridge/stop")
TO_E_STOP = RosService("/bridge/estop")

# Status of every bridge in the graph, own included; it is not of the robot, so not in the table.
NEIGHBOURS = RosTopic(STATUS.name, STRING, out=False, latched=True)

SERVICES = (GET_STATUS, SET_LIVE, *TO_MODE.values(), TO_STOP, TO_E_STOP)
