"""Methods of the interface: an answer from the front's state, or a command to the loop. Front process."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from math import isfinite
from typing import Any

from twind import link
from twind.config.file_changes import edited
from twind.config.hot_keys import is_gains
from twind.exceptions import InvalidInput
from twind.front import annotations as marks
from twind.front import trajectory_submission
from twind.front.accepted_trajectories import AcceptedTrajectory, strip_points
from twind.front.client_calls import STOPS, ClientCall
from twind.front.daemon_log import printable
from twind.front.front_server import FrontServer
from twind.front.monitor_subscribers import TOPICS
from twind.front.overlong_trajectory import OverlongTrajectory
from twind.front.reload_queue import PARAMETERS
from twind.front.state_cache import encode
from twind.front.streamer_report_cache import find_invalid_number
from twind.front.ticket_table import ESTOPS
from twind.front.trajectory_check_queue import TrajectoryCheck
from twind.protocol import SERVICE
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.safety.trajectory_validation import form

# What observe.sock may call: what only reads what is known, a word of streamers, and the stop. Not Check:
# it takes the loop's time, and a second one is refused while the first is judged.
OBSERVER = frozenset({"GetStatus", "GetRobot", "GetParameters", "Monitor", "EStop", "ReportStream"})
LEVELS = ("settle", "cut")  # of an e-stop
SETTABLE = ", ".join([*PARAMETERS, "types.TYPE.gains"])
SIDES = ("lower", "upper")  # of a joint's stops
SILENCE = 2.0  # s without a tick after which a status would pass old values for the present ones
NAME = 40  # characters of an unknown name in an error
REASON = 200  # characters of an e-stop's reason that are kept; a stop is not refused for its prose

Method = Callable[[FrontServer, ClientCall], None]


def forward(
    front: FrontServer,
    call: ClientCall,
    kind: Callable[..., link.Inward],
    fd: int | None = None,
    **fields: Any,
) -> bool:
    """Send a command; the loop's answer goes to the caller. Stops are queued, others may find the pipe full.

    Returns False if it was not sent; the caller has the error then.
    """
    caller = call.caller
    now = front.now()
    if call.oneway and front.tickets.flooded(call):
        front.log.write("warning", EventCode.ONEWAY_FLOOD, now, holder=caller.holder, method=call.method)
        return False
    ticket = front.tickets.open(call, now)
    who = {"client": caller.number, "uid": caller.uid, "holder": caller.holder}
    command = kind(ticket=ticket, received=call.began, **who, **fields)
    sent = True
    try:
        if call.method in STOPS:
            front.foreseen.stop()
            front.link.owe(command)
        else:
            sent = front.link.send(command, fd)
    except InvalidInput as error:
        front.tickets.close(ticket)
        front.refuse(call, [Finding(ReasonCode.FRAME_TOO_LARGE, message=f"command to the loop: {error}")])
        return False
    if not sent:
        front.tickets.close(ticket)
        call.error("Busy", {"what": "the loop: its link is full; try again"})
    return sent


def _as_it_stands(kind: Callable[..., link.Inward]) -> Method:
    """A command whose fields are the method's parameters."""

    def method(front: FrontServer, call: ClientCall) -> None:
        given = {key: value for key, value in call.parameters.items() if value is not None}
        forward(front, call, kind, **given)

    return method


def _not_found(call: ClientCall, what: str, name: str, known: Iterable[str]) -> None:
    call.error("NotFound", {"what": what, "name": name, "known": list(known)})


# ------------------------------------------------------------------------------------- from what is known


def _get_status(front: FrontServer, call: ClientCall) -> None:
    old = 0.0 if front.world.tick is None else front.now() - front.world.tick.time
    if old > SILENCE:
        told = (
            f"the loop: its last report is {old:.1f} s old, bound {SILENCE:g} s; servos may be without torque"
        )
        call.error("Busy", {"what": f"{told}; see the log, or restart the daemon"})
        return
    joints = b',"joints":' + front.world.joints() if call.parameters.get("joints") else b""
    call.reply(b'{"status":' + front.world.status() + joints + b"}")


def _get_robot(front: FrontServer, call: ClientCall) -> None:
    call.reply(front.world.robot())


def _get_parameters(front: FrontServer, call: ClientCall) -> None:
    call.reply(encode({"parameters": front.world.briefing.parameters}))


def _monitor(front: FrontServer, call: ClientCall) -> None:
    topics = call.parameters["topics"]
    rate = call.parameters.get("rate")
    unknown = [topic for topic in topics if topic not in TOPICS]
    if call.oneway:
        call.invalid("oneway", "a monitor that is never answered would watch for ever")
    elif unknown:
        _not_found(call, "topic", unknown[0], TOPICS)
    elif not topics:
        call.invalid("topics", f"name at least one of {', '.join(TOPICS)}")
    elif rate is not None and not rate > 0.0:
        call.invalid("rate", f"{rate} Hz: must be positive, at most {front.world.briefing.rate_hz:g}")
    else:
        front.watch(call, topics, rate)


# ------------------------------------------------------------------------------------- to the loop


def _arm(front: FrontServer, call: ClientCall) -> None:
    joints = call.parameters.get("joints")
    written_anew = edited(front.world.briefing.files)
    if joints is None:
        forward(front, call, link.Arm, edited=written_anew)
        return
    unknown = [name for name in joints if name not in front.world.names.places]
    if unknown:
        _not_found(call, "joint", unknown[0], front.world.names.joints)
    elif len(set(joints)) != len(joints):
        call.invalid("joints", "a joint is named twice")
    else:
        places = [front.world.names.places[name] for name in joints]
        forward(front, call, link.Arm, joints=places, edited=written_anew)


def _find_stop(front: FrontServer, call: ClientCall) -> None:
    given = call.parameters
    places = front.world.names.places
    if given["joint"] not in places:
        _not_found(call, "joint", printable(given["joint"][:NAME]), front.world.names.joints)
    elif given["side"] not in SIDES:
        _not_found(call, "side", printable(given["side"][:NAME]), SIDES)
    else:
        how = {key: given.get(key) for key in ("current_share", "speed", "times")}
        joint = places[given["joint"]]
        forward(front, call, link.FindStop, joint=joint, side=given["side"], more=call.more, **how)


def _locate_joints(front: FrontServer, call: ClientCall) -> None:
    names = call.parameters["joint_names"]
    positions = call.parameters["positions"]
    places = front.world.names.places
    unknown = [name for name in names if name not in places]
    if unknown:
        _not_found(call, "joint", printable(unknown[0][:NAME]), front.world.names.joints)
    elif not names or len(set(names)) != len(names):
        call.invalid("joint_names", "no joint is named, or one twice")
    elif len(positions) != len(names) or not all(map(isfinite, positions)):
        call.invalid("positions", f"must be {len(names)} finite numbers, one for each joint")
    else:
        joints = [places[name] for name in names]
        forward(front, call, link.LocateJoints, joints=joints, positions=positions)


def _estop(front: FrontServer, call: ClientCall) -> None:
    level = call.parameters.get("level") or "settle"
    reason = call.parameters.get("reason") or ""
    if level not in LEVELS:
        _not_found(call, "level", printable(level[:REASON]), LEVELS)
        return
    if front.tickets.stopping(call, level):
        call.error("Busy", {"what": f"{ESTOPS} e-stops of this connection; the stop is under way"})
        return
    checked = printable(reason[:REASON])[:REASON]  # shown in terminals of other users
    forward(front, call, link.EStop, level=level, reason=checked, more=call.more)


def _scan(front: FrontServer, call: ClientCall) -> None:
    if call.parameters.get("bauds") is not None:
        reason = "not served: a bus runs at the robot file's rate while the daemon owns it"
        call.invalid("bauds", reason)
        return
    forward(front, call, link.Scan, bus=call.parameters.get("bus"))


def refuse_overlong(front: FrontServer, call: ClientCall, path: OverlongTrajectory) -> None:
    """Refuse a call whose trajectory was not converted, as it has too many points."""
    if _trajectory_in_time(front, call):
        _, wrong = form(path.joint_names, [()] * path.points, front.world.names.joints)
        _turned_down(front, call, list(wrong), check_only=call.method == "Check")


def _trajectory_in_time(front: FrontServer, call: ClientCall) -> bool:
    return front.in_time(call, "trajectories", "wait, or send longer ones")


def _trajectory(front: FrontServer, call: ClientCall, *, check_only: bool) -> None:
    now = front.now()
    names = front.world.names
    given = call.parameters["trajectory"]
    if not _trajectory_in_time(front, call):
        return
    try:
        message = trajectory_submission.message_of(given)
        policy = trajectory_submission.policy(message, front.world.briefing.description)
    except InvalidInput as error:
        call.invalid(error.where, error.reason)
        return
    path, wrong = trajectory_submission.judge(message, names)
    if path is None:
        _turned_down(front, call, wrong, check_only=check_only)
        return
    fields = trajectory_submission.fields(message, path, names)

    def send(found: Verdict, as_of: float) -> None:
        asked = fields | {"policy": policy, "check_only": check_only, "more": call.more}
        judged = {"refused": found.refusals, "warned": found.warnings, "front_checked": as_of}
        judged["generation"] = front.world.briefing.generation
        with trajectory_submission.SealedTrajectory(path) as fd:
            sent = forward(front, call, link.Submit, fd, **asked, **judged)
        if sent and not check_only:
            front.submitted.wait(
                AcceptedTrajectory(fields["id"], call.caller.holder, path, strip_points(given))
            )

    front.foreseen.judge(TrajectoryCheck(call, path, fields["append_stop"], not check_only, send, now))


def _turned_down(front: FrontServer, call: ClientCall, wrong: list[Finding], *, check_only: bool) -> None:
    """The front's own verdict: the loop never sees the trajectory."""
    verdict = front.report_refusal(call, wrong)
    if check_only:
        call.reply(encode({"verdict": verdict}))
    else:
        call.refuse(verdict["refusals"])


def _setpoint(front: FrontServer, call: ClientCall) -> None:
    names = front.world.names
    given = call.parameters
    wrong = _streamed(given["joint_names"], given["positions"], given.get("velocities"), names.places)
    if wrong:
        front.refuse(call, wrong)
        return
    optional = {
        key: given[key]
        for key in ("velocities", "valid_for", "valid_until", "allow_clamp")
        if given.get(key) is not None
    }
    joints = [names.places[name] for name in given["joint_names"]]
    forward(front, call, link.Setpoint, joints=joints, positions=given["positions"], **optional)


def _streamed(
    joints: list[str], positions: list[float], velocities: list[float] | None, places: dict[str, int]
) -> list[Finding]:
    """UNKNOWN_JOINT to NONFINITE of one setpoint."""
    if len(joints) > len(places):  # before any work that grows with it
        reason = "joint_names: more than the robot has joints"
        return [Finding(ReasonCode.BAD_SHAPE, value=len(joints), bound=len(places), message=reason)]
    wrong = [] if joints else [Finding(ReasonCode.NO_JOINTS, message="no joint is named")]
    for place, name in enumerate(joints):
        if name not in places:
            wrong.append(
                Finding(ReasonCode.UNKNOWN_JOINT, message=f"no joint {name[:40]!r}; GetRobot names them")
            )
        elif name in joints[:place]:
            wrong.append(Finding(ReasonCode.DUP_JOINT, joint=places[name], message="named twice"))
    for what, column in (("positions", positions), ("velocities", velocities)):
        if column is not None and len(column) != len(joints):
            reason = f"{what}: one number per named joint"
            wrong.append(Finding(ReasonCode.BAD_SHAPE, value=len(column), bound=len(joints), message=reason))
        elif column is not None and not all(map(isfinite, column)):
            wrong.append(Finding(ReasonCode.NONFINITE, message=what))
    return wrong


def _mark(front: FrontServer, call: ClientCall) -> None:
    if call.parameters["kind"] not in marks.KINDS:
        _not_found(call, "kind", printable(call.parameters["kind"][:NAME]), marks.KINDS)
        return
    checked = marks.annotation(call.parameters)
    if front.in_time(call, "marks", "wait: they are for people"):  # each is remembered by all that record
        forward(front, call, link.Mark, annotation=checked)


def _report_stream(front: FrontServer, call: ClientCall) -> None:
    found = find_invalid_number(call.parameters["stream"])
    if found is not None:
        call.invalid(f"stream.{found[0]}", found[1])
    elif front.in_time(call, "reports of streams", "one a second is enough"):
        front.streams.take(call.caller.number, call.parameters["stream"], front.now())
        call.reply(b"{}")


def _set_parameters(front: FrontServer, call: ClientCall) -> None:
    """Set parameters until the next start; a client may only tighten the limits of the robot file.

    Gains are for the holder of the lease, and while it holds it.
    """
    given = call.parameters["parameters"]
    now = front.world.briefing.parameters
    if not given:
        call.invalid("parameters", f"name at least one of {SETTABLE}")
        return
    for name, value in given.items():
        if is_gains(name):
            continue
        if name not in PARAMETERS:
            reason = f"changes by its file alone, or not at all; here change {SETTABLE}"
            call.invalid(f"parameters.{printable(name[:40])}", reason)
            return
        number = not isinstance(value, bool) and isinstance(value, int | float)
        if name.endswith("_ms") and not (number and value <= now[name]):
            reason = f"at most {now[name]:g}, as in force: a client may only tighten it"
            call.invalid(f"parameters.{name}", reason)
            return
    front.reloads.ask(call, {PARAMETERS.get(name, name): value for name, value in given.items()})


def _reload(front: FrontServer, call: ClientCall) -> None:
    front.reloads.ask(call)


def _dump_recorder(front: FrontServer, call: ClientCall) -> None:
    front.flights.dump(call)


METHODS: dict[str, Method] = {
    "SetMode": _as_it_stands(link.SetMode),
    "AcquireLease": _as_it_stands(link.AcquireLease),
    "RenewLease": _as_it_stands(link.RenewLease),
    "ReleaseLease": _as_it_stands(link.ReleaseLease),
    "Disarm": _as_it_stands(link.Disarm),
    "Reset": _as_it_stands(link.Reset),
    "Calibrate": _as_it_stands(link.Calibrate),
    "Cancel": _as_it_stands(link.Cancel),
    "ReadRegister": _as_it_stands(link.ReadRegister),
    "WriteRegister": _as_it_stands(link.WriteRegister),
    "Reboot": _as_it_stands(link.Reboot),
    "GetStatus": _get_status,
    "GetRobot": _get_robot,
    "GetParameters": _get_parameters,
    "Monitor": _monitor,
    "Arm": _arm,
    "EStop": _estop,
    "FindStop": _find_stop,
    "LocateJoints": _locate_joints,
    "Check": partial(_trajectory, check_only=True),
    "SubmitTrajectory": partial(_trajectory, check_only=False),
    "Setpoint": _setpoint,
    "SetParameters": _set_parameters,
    "Scan": _scan,
    "Mark": _mark,
    "ReportStream": _report_stream,
    "Reload": _reload,
    "DumpRecorder": _dump_recorder,
}


# ------------------------------------------------------------------------------------- org.varlink.service


def service(front: FrontServer, call: ClientCall) -> None:
    """Answer a call of `org.varlink.service`: product, version, interfaces."""
    if call.method == "GetInfo":
        product = {"vendor": "twind", "product": "twind", "url": "https://github.com/twind/twind"}
        version = front.world.briefing.version
        call.reply(encode(product | {"version": version, "interfaces": list(front.interfaces)}))
        return
    wanted = front.interfaces.get(call.parameters["interface"])
    if wanted is None:
        call.error("InterfaceNotFound", {"interface": call.parameters["interface"]}, SERVICE)
    else:
        call.reply(encode({"description": wanted.description}))
