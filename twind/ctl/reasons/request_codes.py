"""Reason codes of requests: messages, trajectories, setpoints, arming and changes of mode."""

from collections.abc import Mapping

from twind.ctl.reasons.reason_text import ReasonText
from twind.robot.finding import ReasonCode

REFUSED = "refused"

REQUEST_CODES: Mapping[ReasonCode, ReasonText] = {
    ReasonCode.FRAME_TOO_LARGE: ReasonText(
        "refused, connection closed",
        "A message exceeds 64 KiB (observe socket) or 4 MiB (control socket).",
        "send fewer points",
    ),
    ReasonCode.FRAME_INCOMPLETE: ReasonText(
        "refused, connection closed",
        "A message has no terminator: at the end of what the client sent, or after 5 s if it is the first.",
        "end each message with NUL or a newline",
    ),
    ReasonCode.RATE_LIMIT: ReasonText(
        REFUSED,
        "One process sent too many trajectories or `Mark` calls in one second. Ten in a row close the "
        "connection.",
        "wait, or send longer trajectories",
    ),
    ReasonCode.BAD_JSON: ReasonText(
        REFUSED,
        "The message is not strict UTF-8 JSON: NaN, numbers beyond 64 bits, a repeated key, over 16 "
        "levels. Ten close the connection.",
        "correct the message",
    ),
    ReasonCode.BAD_SCHEMA: ReasonText(
        REFUSED,
        "The message is no call, names an unknown policy, or has a tolerance that is not positive.",
        "compare the call with docs/protocol.md",
    ),
    ReasonCode.AUTH_ROLE: ReasonText(
        "refused (error `NotAllowed`)", "This socket does not permit the method.", "use control.sock"
    ),
    ReasonCode.LEASE_MISSING: ReasonText(
        "refused; `Check` warns",
        "This connection does not hold the lease.",
        "call AcquireLease on the same connection",
    ),
    ReasonCode.ESTOP_LATCHED: ReasonText(
        REFUSED, "An e-stop is latched.", "find the cause, then `twindctl reset`"
    ),
    ReasonCode.FAULT_LATCHED: ReasonText(
        "refused; ends a stream",
        "A fault is latched. `twindctl status` names it.",
        "remedy the latched fault, `twindctl disarm`, `twindctl reset`",
    ),
    ReasonCode.MODE_DENIES: ReasonText(
        REFUSED,
        "Arming outside `live`, or a change of mode with torque on or in a state that forbids it.",
        "`twindctl disarm`, then `twindctl mode live`",
    ),
    ReasonCode.NOT_ARMED: ReasonText(
        REFUSED, "Motion in `live`, but the robot is not armed or holds no position.", "`twindctl arm`"
    ),
    ReasonCode.JOINT_LIMP: ReasonText(
        REFUSED,
        "The joint was left limp when the others were armed, or may not be: a leg of a robot that stands "
        "freely, a joint that shares motors with others.",
        "`twindctl disarm`, then arm it too",
    ),
    ReasonCode.ROBOT_UNFINISHED: ReasonText(
        REFUSED, "`todo` of the robot file has open items.", "`twindctl robot finish`"
    ),
    ReasonCode.CALIB_MISSING: ReasonText(
        REFUSED,
        "A joint has no measured zero, or `live` has no calibration file.",
        "give `--calibration FILE`, or calibrate: `twindctl calibrate sweep`",
    ),
    ReasonCode.CALIB_MISMATCH: ReasonText(
        "refused; firmware, implausible travel: warning",
        "A device differs from its calibration, restarted, or reported a hardware error. Or its turn "
        "is unknown, homing has not restored its settings, or a robot file changed.",
        "follow its message; `twindctl doctor` gives the command that restores a servo's setting",
    ),
    ReasonCode.HW_DISCONNECTED: ReasonText(
        REFUSED,
        "A joint to be moved or armed sent no recent reading, or `live` has no port.",
        "check cable and power; `twindctl scan`; give `--port BUS=PORT`",
    ),
    ReasonCode.LATENCY_WARN: ReasonText(
        "warning",
        "Latency exceeds the first bound. The event names the hop; `LATENCY_CALM` reports the recovery.",
        "`twindctl doctor`: latency timer, load of this machine",
    ),
    ReasonCode.LATENCY_BLOCK: ReasonText(
        REFUSED,
        "Latency, or its 95 % quantile over 0.5 s, exceeds the second bound or is unknown.",
        "`twindctl doctor`: latency timer, load of this machine",
    ),
    ReasonCode.CMD_EXPIRED: ReasonText(
        REFUSED,
        "Start, `valid_for` or `valid_until` has passed, or the check took too long.",
        "send the command again",
    ),
    ReasonCode.TOO_DISTANT: ReasonText(REFUSED, "`start_in` is too long.", "send the command later"),
    ReasonCode.VALID_TOO_LONG: ReasonText(
        REFUSED, "`valid_for` of a setpoint is too long.", "send setpoints more often"
    ),
    ReasonCode.STREAM_STOPPED: ReasonText(
        REFUSED,
        "Another client stopped the stream, and this setpoint continues it.",
        "send no setpoint for 0.5 s, then begin anew",
    ),
    ReasonCode.EMPTY: ReasonText(REFUSED, "The trajectory has no points.", "add points"),
    ReasonCode.NO_JOINTS: ReasonText(REFUSED, "No joint is named.", "name the joints"),
    ReasonCode.UNKNOWN_JOINT: ReasonText(
        REFUSED,
        "The robot has no such joint. The message lists similar names.",
        "use a name from `twindctl status --joints`",
    ),
    ReasonCode.DUP_JOINT: ReasonText(REFUSED, "A joint is named twice.", "name each joint once"),
    ReasonCode.BAD_SHAPE: ReasonText(
        REFUSED,
        "Rows and names differ in length, only some points have velocities, or only some joints are "
        "to be armed.",
        "give one number per joint and point",
    ),
    ReasonCode.TOO_MANY_POINTS: ReasonText(
        REFUSED, "The trajectory has too many points or lasts too long.", "split the trajectory"
    ),
    ReasonCode.NONFINITE: ReasonText(
        "refused; in a tick HOLD",
        "A number is NaN or infinite. In a tick that goal is not written.",
        "correct the program that computed the numbers",
    ),
    ReasonCode.TIME_ORDER: ReasonText(
        REFUSED, "Times do not increase, or are too close.", "correct the times"
    ),
    ReasonCode.POS_LIMIT: ReasonText(
        REFUSED,
        "The path leaves the limits of the robot file, at or between points.",
        "stay inside the bound that the message names",
    ),
    ReasonCode.START_JUMP: ReasonText(
        REFUSED,
        "The first point is too far from the start of the motion, or that is unknown.",
        "start at the present goal, or give the first point more time",
    ),
    ReasonCode.VEL_LIMIT: ReasonText(
        REFUSED,
        "A joint exceeds its velocity limit (default 2 rad/s).",
        "give the motion more time, or use --retime",
    ),
    ReasonCode.ACC_LIMIT: ReasonText(
        REFUSED,
        "A joint exceeds its acceleration limit (default 10 rad/s²). Without velocities, the bends at "
        "points count. A single point at 0 s needs rest.",
        "give more time, velocities at the points, or --retime",
    ),
    ReasonCode.JERK_LIMIT: ReasonText("warning", "The jerk of the path is high.", "use smoother points"),
    ReasonCode.BRAKE_DISTANCE: ReasonText(
        REFUSED,
        "A joint moves too fast towards a limit to stop before its hard limit.",
        "move slower near the limit, or use --retime",
    ),
    ReasonCode.END_NOT_AT_REST: ReasonText(
        REFUSED, "The last point has a velocity.", "end with velocity 0, or set append_stop"
    ),
    ReasonCode.SELF_COLLISION: ReasonText(
        "refused; below `warn_m` a warning",
        "The path, or the stop after a setpoint, brings two bodies closer than `block_m`, or their "
        "clearance cannot be proved.",
        "avoid the pair in the message; `twindctl check robot FILE` proposes pairs to allow",
    ),
    ReasonCode.KEEP_OUT: ReasonText(
        REFUSED,
        "The path brings a body closer than `world_m` to the world's geometry.",
        "keep clear of the geometry in the message, or lower `collision.world_m`",
    ),
    ReasonCode.FLOOR: ReasonText(
        REFUSED,
        "The path brings a body closer than `world_m` to a plane of the world.",
        "keep clear of the plane; an arm that grips things on it: `collision: {world_m: 0.005}`",
    ),
    ReasonCode.TORQUE_INFEASIBLE: ReasonText(
        "warning; with `on_torque: reject` refused",
        "The path needs over 0.8 of a joint's torque. With `reject` the limit must be known.",
        "move slower, carry less load, or choose another pose",
    ),
    ReasonCode.UNSTABLE_POSE: ReasonText(
        "warning",
        "`support: free`: on its lowest foot, the centre of mass is under 10 mm inside the support "
        "polygon, or the model has no foot.",
        "choose another pose",
    ),
    ReasonCode.THERMAL_HEADROOM: ReasonText(
        REFUSED,
        "`live`: an actuator to be moved or armed is hotter than `heat: slow_c` (XM430: 65 °C), or "
        "sent no recent temperature.",
        "let the actuator cool",
    ),
    ReasonCode.VOLTAGE_LOW: ReasonText(
        REFUSED,
        "`live`: the supply is at or below `supply: settle_v` (XM430: 10.5 V), or has no recent value.",
        "charge or replace the battery, or use another supply",
    ),
    ReasonCode.BUSY: ReasonText(
        REFUSED,
        "Another trajectory is checked or waits to start, the robot moved during a long check, or a "
        "stream runs.",
        "wait and send again; send long trajectories from a hold",
    ),
    ReasonCode.RETIMED: ReasonText("change", "The path was slowed by the factor given.", "nothing"),
    ReasonCode.STOP_APPENDED: ReasonText("change", "A ramp to rest follows the last point.", "nothing"),
    ReasonCode.CONFIG_REFUSED: ReasonText(
        "refused; old configuration stays",
        "The files are not usable, or contain a change that needs a restart.",
        "correct the file, then `twindctl reload`; or restart",
    ),
}
