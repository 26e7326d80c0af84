"""`twindctl policy run`: the code between a terminal and a drive."""

import argparse
import gc
import json
import sys
import threading
from collections.abc import Mapping
from math import inf
from typing import Any

from threadpoolctl import threadpool_limits

from twind.command_line.progress import ProgressLine
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import (
    DONE,
    REFUSED,
    Rejected,
    UsageError,
    complain,
    harmless,
    observer,
    operator,
    show,
)
from twind.ctl.status_table import state_text
from twind.exceptions import InvalidInput, OperationFailed
from twind.learn.cards.driven_policy import AnyPolicy, actor_for, command_for, task_for
from twind.learn.live.base_estimator import BaseEstimator
from twind.learn.live.daemon_robot import plant_from_answer, require_mode
from twind.learn.live.setpoint_session import SetpointSession
from twind.learn.policy.onnx_session import limit_memory
from twind.learn.policy.policy_actor import PolicyActor
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.policy.policy_controller import PolicyController
from twind.learn.policy.policy_run import RECENT, PolicyRun
from twind.learn.task.reward import RewardFunction
from twind.robot_client.require_armed import require_armed, stopped_text
from twind.robot_client.state_subscriber import StateSubscriber
from twind_drivers.clock import MonotonicClock

MANY = 0.02  # of the periods: so many missed ones are reported with a remedy
BUSY = (
    "busy     this machine had no time for every period: in a missed one no setpoint is sent, and the robot "
    "goes on by the last one, or holds; run less beside it, or `nice -n -10 twindctl policy run FILE`"
)


def run_policy(options: argparse.Namespace, policy: AnyPolicy) -> int:
    """Drive; 1 when it ended otherwise than asked. Raises UsageError, Rejected, ClientError."""
    if options.seconds is not None and not options.seconds > 0.0:
        raise UsageError(f"--seconds {options.seconds:g}: must be above 0")
    threadpool_limits(limits=1)  # a second thread would only be waited for
    with observer(options) as client:
        status = client.call("GetStatus")["status"]
        answer = client.call("GetRobot")
    rate_hz = float(status["loop"]["rate_hz"])
    try:
        require_mode(status["mode"])
        require_armed(status)
        task = task_for(policy)
        command = command_for(options, policy)
        plant = plant_from_answer(answer, 1.0 / rate_hz)
        actor = actor_for(policy, PolicyRobot.from_get_robot(answer["robot"], rate_hz), plant.default)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    judge = RewardFunction(task, plant)
    controller = PolicyController(
        actor,
        BaseEstimator(plant),
        judge.fallen,
        command,
        MonotonicClock().now,
        judge.per_step(command, task.phases(actor.period)),
    )
    with policy.ending_long_inferences():
        return _drive(options, controller, actor, rate_hz)


def _drive(
    options: argparse.Namespace, controller: PolicyController, actor: PolicyActor, rate_hz: float
) -> int:
    subscriber = StateSubscriber(observer(options), actor.joints, rate_hz)
    try:
        session = SetpointSession(operator(options), actor.joints, actor.period, take=options.take)
        try:
            with catch_stop_signals() as stop, ProgressLine(options, "policy") as progress:

                def print_reason(reason: str) -> None:
                    progress.clear()
                    print(f"twindctl: holds: {harmless(reason)}", file=sys.stderr, flush=True)

                drive = PolicyRun(
                    controller,
                    subscriber,
                    session,
                    actor.period,
                    1.0 / rate_hz,
                    MonotonicClock(),
                    print_reason,
                )
                good, why = _move_and_run(options, drive, session, controller, stop, progress)
        finally:
            session.drop()
    finally:
        subscriber.close()
    return _report(options, drive, controller, good, why, subscriber.status)


def _move_and_run(
    options: argparse.Namespace,
    drive: PolicyRun,
    session: SetpointSession,
    controller: PolicyController,
    stop: threading.Event,
    progress: ProgressLine,
) -> tuple[bool, str]:
    """Move to the default pose, then drive."""
    progress.update("to the default pose")
    try:
        if not session.go(controller.shaper.default, stop.is_set):
            return True, "stopped"
    except OperationFailed as error:
        return False, str(error)
    limit_memory()  # after all that a drive loads
    gc.collect()
    gc.freeze()  # what is here stays: no collection looks at it while it drives

    def print_state(drive: PolicyRun) -> None:
        if options.json:
            figures = {"phase": "running"} | drive.log.plain(controller, drive.timer, RECENT)
            print(json.dumps(figures), flush=True)
        elif progress.live:
            progress.update(_line(drive.log.plain(controller, drive.timer, RECENT), controller.holding))

    return drive.run(options.seconds or inf, stop.is_set, print_state)


def _line(figures: Mapping[str, Any], holding: str | None) -> str:
    text = (
        f"{figures['rate_hz']} Hz, late p99 {_ms(figures['late_p99_ms'])}, "
        f"inference p99 {_ms(figures['inference_p99_ms'])}, {figures['refused']} refused, "
        f"{figures['holds']} holds, tilt {figures['tilt_deg']}°"
    )
    return f"HOLDS: {holding}; {text}" if holding else text


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} ms"


def _report(
    options: argparse.Namespace,
    drive: PolicyRun,
    controller: PolicyController,
    good: bool,
    why: str,
    status: Mapping[str, Any],
) -> int:
    figures: dict[str, object] = {"phase": "ended", "as_asked": good, "why": why} | drive.log.plain(
        controller, drive.timer
    )
    lines = [why] if good else []
    lines += _figures(figures) if figures["late_max_ms"] is not None else []
    lines.append(_after(status))
    show(options, figures, "\n".join(lines))
    if not good and not options.json:
        complain(options, Rejected(why))
    return DONE if good else REFUSED


def _figures(figures: Mapping[str, Any]) -> list[str]:
    """Return the lines of statistics of a drive that began."""
    lines = [
        f"{figures['steps']} steps in {figures['seconds']:.1f} s, {figures['missed']} missed",
        f"late p50 {_ms(figures['late_p50_ms'])}, p99 {_ms(figures['late_p99_ms'])}; inference p99 "
        f"{_ms(figures['inference_p99_ms'])}; from a tick to its setpoint p50 {_ms(figures['way_p50_ms'])}, "
        f"p99 {_ms(figures['way_p99_ms'])}",
        f"{figures['refused']} refused, {figures['holds']} holds{_held(figures)}, "
        f"tilt at most {figures['most_tilt_deg']:g}°, return {_number(figures['return_per_step'])} per step",
    ]
    missed = figures["missed"] > MANY * (figures["steps"] + figures["missed"])
    if (missed and figures["steps"]) or figures["too_late"]:
        lines.append(BUSY)
    lines += [
        f"refused  {code}{f' {joint}' if joint else ''}: {count} times"
        for code, joints in figures["refusals"].items()
        for joint, count in joints.items()
    ]
    return lines + [f"held     {reason}" for reason in figures["why_held"]]


def _held(figures: Mapping[str, object]) -> str:
    return f" of {figures['held_s']:.1f} s together" if figures["holds"] else ""


def _after(status: Mapping[str, object]) -> str:
    if status["mode"] == "live" and status["armed"]:
        return "the robot holds with torque on, and no client drives it: `twindctl disarm` lowers it"
    if status["mode"] == "live" and (stop := stopped_text(status)):
        return f"no client drives it now: {stop}"
    mode = str(status["mode"])
    return f"no client drives it now: mode {mode}, {state_text(mode, str(status['state']))}"
