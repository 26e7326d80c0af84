"""`twindctl estop`: by the sockets, or by SIGTERM where they are gone. Standard library only."""

import argparse
import os

from twind.client import NoDaemon
from twind.command_line.verb import DONE, FunctionVerb, Rejected, connected, remote_robot, show
from twind.protocol.socket_paths import SYSTEM
from twind.robot.finding import ReasonCode
from twind.robot.recovery_steps import THEN, reset_steps

LOWERING = 30.0  # s that a daemon may take to lower its robot and end


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cut", action="store_true", help="torque off at once: the robot may fall")
    parser.add_argument("--reason", help="for the log")


def _run(options: argparse.Namespace) -> int:
    level = "cut" if options.cut else "settle"
    try:
        client = connected(options, "control", "observe")
    except NoDaemon as error:
        if not error.absent or remote_robot(options) is not None:
            raise
        return terminate_daemons(options, error)
    with client:
        answer = client.call("EStop", level=level, reason=options.reason)
    off = answer.get("torque_off")
    torque = "torque unknown" if off is None else f"torque is {'off' if off else 'on'}"
    next_step = f"next: {reset_after_estop(answer['state'], torque_off=off)}"
    show(options, answer, f"e-stop ({level}): state {answer['state']}, {torque}\n{next_step}")
    return DONE


def reset_after_estop(state: str, *, torque_off: bool | None) -> str:
    """Return the next step after an e-stop: a reset is refused while torque is on. None: unknown."""
    if torque_off is None:
        return "keep clear until `twindctl status` shows no silent joint, then `twindctl reset`"
    return THEN.join(reset_steps(state, (ReasonCode.ESTOP,), torque_on=not torque_off))


def terminate_daemons(options: argparse.Namespace, absent: NoDaemon) -> int:
    """Have each daemon that still serves the folder lower its robot and end. Raises NoDaemon, Rejected."""
    from twind.ctl import lost_socket_daemon  # a status or an ordinary e-stop does not pay for it

    signalled: dict[int, int] = {}
    denied: lost_socket_daemon.LostSocketDaemon | None = None
    for daemon in lost_socket_daemon.find(lost_socket_daemon.folders(options.socket)):
        try:
            signalled[daemon.pid] = lost_socket_daemon.terminate(daemon)
        except ProcessLookupError:  # it ended by itself
            continue
        except PermissionError:  # another one may be ours to end
            denied = daemon
            continue
        if not options.json:
            show(options, None, _signalled(daemon.folder, daemon.pid, cut=options.cut))
    if not signalled and denied is None:
        raise absent
    remaining = [pid for pid, pidfd in signalled.items() if not lost_socket_daemon.ended(pidfd, LOWERING)]
    if remaining:
        listed = ", ".join(map(str, remaining))
        raise Rejected(
            f"twind (pid {listed}) received SIGTERM and did not end within {LOWERING:g} s: "
            "use the robot's power switch"
        )
    if denied is not None:
        raise Rejected(_not_allowed(denied.folder, denied.uid))
    data = {"signal": "SIGTERM", "pids": list(signalled), "level": "settle", "ended": True}
    show(options, data, "twind has ended; torque that another program switched on stays on: check the robot")
    return DONE


def _signalled(folder: str, pid: int, *, cut: bool) -> str:
    text = f"{folder}: no socket, but twind (pid {pid}) serves it: SIGTERM sent; it lowers the robot and ends"
    power = "\n--cut needs the socket: the robot is lowered instead; to cut, use the robot's power switch"
    return text + power if cut else text


def _not_allowed(folder: str, uid: int) -> str:
    """The error with a command for a user that may signal the daemon."""
    unit = _unit(folder)
    command = f"systemctl stop {unit}" if unit else f"twindctl --socket {os.path.abspath(folder)} estop"
    return (
        f"{folder}: no socket, but a twind of uid {uid} serves it, which this user may not signal: "
        f"run `sudo {command}`, which lowers the robot, or use its power switch"
    )


def _unit(folder: str) -> str:
    """The service whose sockets are in `folder`; "": of no service."""
    above, name = os.path.split(os.path.abspath(folder))
    if os.path.join(above, name) == SYSTEM:
        return "twind"
    return f"twind@{name}" if above == SYSTEM else ""


ESTOP = FunctionVerb(
    "drive", "Stop now; with --cut, switch torque off at once.", _arguments, _run, supports_remote=True
)
