"""Reason codes of requests: messages, trajectories, setpoints, arming and changes of mode."""

from collections.abc import Mapping

from twind.ctl.reasons.reason_text import ReasonText
from twind.robot.finding import ReasonCode

REFUSED = "refused"

REQUEST_CODES: Mapping[ReasonCode, ReasonText] = {
    ReasonCode.FRAME_TOO_LARGE: ReasonText(
        "refused, connection closed",
        "A message exceeds 64 KiB (observe socket) or 4 MiB (control socket), or has no end. "
        "Also a command that does not fit into the link to the loop.",
        "send fewer points",
    ),
    ReasonCode.RATE_LIMIT: ReasonText(
        REFUSED,
        "One process sent too many trajectories or `Mark` calls in one second, over all its connections. "
        "Ten refusals in a row close the connection.",
        "wait, or send longer trajectories",
    ),
    ReasonCode.BAD_JSON: ReasonText(
        REFUSED,
        "The message is not strict UTF-8 JSON: NaN, Infinity, a number beyond double or 64 bits, a "
        "repeated key, more than 16 levels, a byte order mark. Ten of them close the connection.",
        "correct the message",
    ),
    ReasonCode.BAD_SCHEMA: ReasonText(
        REFUSED,
        "The message has not the form of a call, names an unknown policy, or has a tolerance that is "
        "not positive.",
        "compare the call with docs/protocol.md",
    ),
    ReasonCode.AUTH_ROLE: ReasonText(
        "refused (error `NotAllowed`)",
        "The role of this socket does not permit the method. Log and topic `verdicts` report it once per "
        "method and connection.",
        "use control.sock",
    ),
    ReasonCode.LEASE_MISSING: ReasonText(
        "refused; `Check` warns",
        "This connection does not hold the lease: never acquired, expired, released or taken by another "
        "client.",
        "call AcquireLease on the same connection",
    ),
    ReasonCode.ESTOP_LATCHED: ReasonText(
        REFUSED, "An e-stop is latched.", "find out why the robot was stopped, then `twindctl reset`"
    ),
    ReasonCode.FAULT_LATCHED: ReasonText(
        "refused; ends a stream",
        "A fault is latched. `twindctl status` names it.",
        "remedy the latched fault, `twindctl disarm`, `twindctl reset`",
    ),
    ReasonCode.MODE_DENIES: ReasonText(
        REFUSED,
        "Arming outside `live`; or a change of mode in a state that does not allow it, or with torque on.",
        "`twindctl disarm`, then `twindctl mode live`",
    ),
    ReasonCode.NOT_ARMED: ReasonText(
        REFUSED, "Motion in `live` while the robot is not armed or holds no position.", "`twindctl arm`"
    ),
    ReasonCode.CALIB_MISSING: ReasonText(
        REFUSED,
        "A joint has no measured zero, or `live` has no calibration file.",
        "give `--calibration FILE`, or calibrate: `twindctl calibrate sweep`",
    ),
    ReasonCode.CALIB_MISMATCH: ReasonText(
        "refused; for firmware and implausible travel a warning",
        "A device differs from its calibration: model, homing offset, drive or operating mode, position "
        "limits, tag, unique id. Or: its turn is unknown or unusable; it restarted or reported a hardware "
        "error; homing has not restored its settings; a robot file changed after it was read.",
        "`twindctl doctor` names the difference; restore it, restart, or calibrate again",
    ),
    ReasonCode.HW_DISCONNECTED: ReasonText(
        REFUSED,
        "A joint that is to move or to be armed sent no recent reading, or `live` has no port.",
        "check cable and power; `twindctl scan`; give `--port BUS=PORT`",
    ),
    ReasonCode.LATENCY_WARN: ReasonText(
        "warning",
        "Latency exceeds the first bound. The event names the hop once; event `LATENCY_CALM` reports the "
        "recovery.",
        "`twindctl doctor`: latency timer, load of this machine",
    ),
    ReasonCode.LATENCY_BLOCK: ReasonText(
        REFUSED,
        "The present latency, or 95 % of the last 0.5 s, exceeds the second bound, or latency is unknown "
        "or negative.",
        "`twindctl doctor`: latency timer, load of this machine",
    ),
    ReasonCode.CMD_EXPIRED: ReasonText(
        REFUSED,
        "The start lies in the past, `valid_for` is over, or the check took too long.",
        "send the command again",
    ),
    ReasonCode.TOO_DISTANT: ReasonText(
        REFUSED, "`start_in` or `valid_for` is too long.", "send the command later, or more often"
    ),
    ReasonCode.EMPTY: ReasonText(REFUSED, "The trajectory has no points.", "add points"),
    ReasonCode.NO_JOINTS: ReasonText(REFUSED, "No joint is named.", "name the joints"),
    ReasonCode.UNKNOWN_JOINT: ReasonText(
        REFUSED,
        "The robot has no joint of this name. The message lists the nearest names.",
        "use a name from `twindctl status --joints`",
    ),
    ReasonCode.DUP_JOINT: ReasonText(REFUSED, "A joint is named twice.", "name each joint once"),
    ReasonCode.BAD_SHAPE: ReasonText(
        REFUSED,
        "A row and the list of names differ in length; only some points have velocities; accelerations "
        "without velocities; arming of some joints only.",
        "give one number per joint and point",
    ),
    ReasonCode.TOO_MANY_POINTS: ReasonText(
        REFUSED, "The trajectory has too many points or lasts too long.", "split the trajectory"
    ),
    ReasonCode.NONFINITE: ReasonText(
        "refused; in a tick HOLD",
        "A number is NaN or infinite. In a tick the daemon does not write that goal.",
        "correct the program that computed the numbers",
    ),
    ReasonCode.TIME_ORDER: ReasonText(
        REFUSED, "Times do not increase, or are too close.", "correct the times"
    ),
    ReasonCode.POS_LIMIT: ReasonText(
        REFUSED,
        "The path leaves the limits of the robot file, at a point or between points.",
        "stay inside the bound that the message names",
    ),
    ReasonCode.START_JUMP: ReasonText(
        REFUSED,
        "The first point is too far from where the motion starts, or that position is unknown.",
        "start at the present goal, or give the first point more time",
    ),
    ReasonCode.VEL_LIMIT: ReasonText(
        REFUSED,
        "A joint exceeds its velocity limit (2 rad/s where the robot file gives none).",
        "give the motion more time, or use --retime",
    ),
    ReasonCode.ACC_LIMIT: ReasonText(
        REFUSED,
        "A joint exceeds its acceleration limit (10 rad/s² where the robot file gives none). Lines "
        "without velocities bend at their points: the change of velocity there counts. For a path that "
        "starts at 0 s, the change from the running velocity counts over half of its first segment. "
        "A single point at 0 s needs a joint at rest.",
        "give more time, give velocities at the points, or use --retime",
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
        "The path, or the stop after a setpoint, brings two bodies closer than `block_m`. Also: clearance "
        "not proved within the permitted work, a joint of unknown position, or no model.",
        "avoid the pair in the message; `twindctl check robot FILE` proposes pairs to allow",
    ),
    ReasonCode.KEEP_OUT: ReasonText(
        REFUSED,
        "The path brings a body closer than `world_m` to the world's geometry.",
        "keep clear of the geometry in the message",
    ),
    ReasonCode.FLOOR: ReasonText(
        REFUSED, "The same for a plane of the world.", "keep clear of the floor plane in the message"
    ),
    ReasonCode.TORQUE_INFEASIBLE: ReasonText(
        "warning; refused with `gate: {on_torque: reject}`",
        "By inverse dynamics the path needs more than 0.8 of the joint's torque (torque constant × current "
        "limit). Unknown limit: not judged, with `reject` refused. A load that the joint already bears "
        "at rest and that does not grow is never refused.",
        "move slower, carry less load, or choose another pose",
    ),
    ReasonCode.UNSTABLE_POSE: ReasonText(
        "warning",
        "`support: free`: flat on its lowest foot, the robot's centre of mass comes closer than 10 mm to "
        "the edge of its support polygon, or the model has no foot.",
        "choose another pose",
    ),
    ReasonCode.THERMAL_HEADROOM: ReasonText(
        REFUSED,
        "`live`: an actuator of a joint that is to move or to be armed is hotter than `heat: slow_c` "
        "(65 °C for an XM430), or has no recent temperature. A running stream goes on until OVERTEMP. "
        "Models without known bounds are not judged.",
        "let the actuator cool",
    ),
    ReasonCode.VOLTAGE_LOW: ReasonText(
        REFUSED,
        "The same for the supply: at or below `supply: settle_v` (10.5 V for an XM430 at 12 V), or no "
        "recent value.",
        "charge or replace the battery, or use another supply",
    ),
    ReasonCode.BUSY: ReasonText(
        REFUSED,
        "Another trajectory is being checked or waits for its start; the robot moved, or a stop came, "
        "during a long check; or a later start was asked for during a stream.",
        "wait and send again; send long trajectories from a hold",
    ),
    ReasonCode.RETIMED: ReasonText("change", "The whole path was slowed by the factor given.", "nothing"),
    ReasonCode.STOP_APPENDED: ReasonText("change", "A ramp to rest follows the last point.", "nothing"),
    ReasonCode.CONFIG_REFUSED: ReasonText(
        "refused; old configuration stays",
        "Files that were read again are not usable, or contain a change that needs a restart.",
        "correct the file at the line in the message, then `twindctl reload`; or restart",
    ),
}
