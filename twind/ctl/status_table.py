"""`twindctl status`: status and joints as text. Standard library only."""

import argparse
from collections.abc import Sequence

from twind.client.errors import finding_lines
from twind.command_line.text_table import align_columns, fixed_number
from twind.command_line.verb import DONE, FunctionVerb, observer, show
from twind.protocol.messages import (
    BusMessage,
    GapMessage,
    JointMessage,
    LoopMessage,
    StatusMessage,
    StreamingMessage,
)
from twind.robot.modes import RESET_STATES, Mode, RobotState
from twind.robot.recovery_steps import THEN, UNKNOWN, reported_torque, reset_steps

LOST = (("dropped", "DROPPED"), ("dead", "dead letters"), ("failures", "failures"))  # of a streamer
UNWATCHED = "if the daemon dies, they drive on to their last goal and hold it"
INHERITED = "torque   was found on: `twindctl arm` takes it over, `twindctl disarm` lowers the robot"
SHOWN = 3  # names in one line
SILENT = 500.0  # ms without a reply after which a joint is named; its torque is unknown by then
COLUMNS = ("joint", "rad", "goal", "rad/s", "N·m", "°C", "V", "age ms", "torque", "")


def render(status: StatusMessage, joints: Sequence[JointMessage] | None = None, *, table: bool = True) -> str:
    """Text of a status, with the joints that do not reply; `table`: and all joints as a table."""
    simulated = status["mode"] == Mode.SIM
    rows = ["", *joint_lines(joints, simulated=simulated)] if joints and table else []
    return "\n".join([*status_lines(status, joints or ()), *rows])


def status_lines(status: StatusMessage, joints: Sequence[JointMessage] = ()) -> list[str]:
    """One line each for the robot, its buses and the loop; faults last, with remedies."""
    loop = status["loop"]
    lease = status["lease"]
    flags = ["torque on"] * (status["armed"] and status["state"] != RobotState.ARMED)
    flags += ["inherited"] * status["inherited"]
    head = [
        status["robot"],
        f"mode {status['mode']}",
        state_text(status["mode"], status["state"]),
        f"motion {status['motion']}",
    ]
    held = "free" if lease is None else f"{lease['holder']}, for {lease['expires_in']:.2f} s"
    lines = [" · ".join([*head, *flags]), f"lease    {held}"]
    if status["inherited"]:
        lines.append(INHERITED)
    if status["mode"] != Mode.SIM:  # no bus, so no latency
        lines.append(f"latency  {latency_text(status)}")
    lines.append(f"loop     {loop_text(loop)}")
    for bus in status["buses"]:
        lines += _bus_lines(bus, simulated=status["mode"] == Mode.SIM)
    if status.get("skew_ms") is not None:
        lines.append(f"skew     {_ms(status['skew_ms'])} between the buses, max {_ms(status['skew_max_ms'])}")
    lines += _silent_lines(status, joints)
    if unwatched := status.get("unwatched"):
        lines.append(f"watchdog none in {len(unwatched)} joints ({_names(unwatched)}): {UNWATCHED}")
    if status.get("bodiless"):
        lines.append("model    joints without bodies: neither collision nor torque is judged")
    if status.get("supply_relay") is not None:
        lines.append(f"relay    {status['supply_relay']}")
    if status.get("stop_button") is not None:
        lines.append(f"button   {status['stop_button']}")
    if status.get("fall") is not None:
        lines.append(f"balance  {status['fall']}")
    lines += gap_lines(status.get("gap"))
    lines += [f"stream   {text}" for text in map(stream_text, status.get("streams") or ())]
    return [*lines, *_fault_lines(status)]


def _names(names: Sequence[str]) -> str:
    """Format the first names of many."""
    return f"{', '.join(names[:SHOWN])}{', ...' if len(names) > SHOWN else ''}"


def _silent_lines(status: StatusMessage, joints: Sequence[JointMessage]) -> list[str]:
    """Format which joints of an identified robot do not reply: after a reset nothing else reports them."""
    if status["mode"] == Mode.SIM or status["state"] in (RobotState.DISCONNECTED, RobotState.IDENTIFYING):
        return []
    silent = [joint for joint in joints if joint["age_ms"] is None or joint["age_ms"] > SILENT]
    if not silent:
        return []
    unknown = status["mode"] == Mode.LIVE and any(joint["torque"] is None for joint in silent)
    torque = f": {UNKNOWN}" if unknown else ""
    names = _names([joint["name"] for joint in silent])
    return [f"silent   {len(silent)} of {len(joints)} joints ({names}){torque}"]


def state_text(mode: str, state: str) -> str:
    """Format the state; in mode sim no robot is connected, which is no fault."""
    return "simulated robot" if (mode, state) == (Mode.SIM, RobotState.DISCONNECTED) else f"state {state}"


def _bus_lines(bus: BusMessage, *, simulated: bool) -> list[str]:
    """Format a bus and its warning. Mode sim opens none."""
    name = bus["name"]
    warning = [f"warning  {name}: {bus['warning']}"] if bus.get("warning") else []
    if not bus["connected"]:
        if simulated:
            return warning
        if not bus["port"]:
            return [f"bus      {name}: no port; start twind with --port, or with --virtual", *warning]
    state = "connected" if bus["connected"] else "not connected"
    text = (
        f"bus      {name} on {bus['port'] or 'no port'}: {state}, {_ms(bus['latency_ms'])}, "
        f"{bus['utilisation']:.0%} of the tick, {bus['errors']} errors in {bus['exchanges']} exchanges"
    )
    return [text, *warning]


def _fault_lines(status: StatusMessage) -> list[str]:
    """Faults and arming refusals, a remedy for each code, and whether a reset is needed."""
    faults = status["faults"]
    if not faults:
        return []
    from twind.ctl.reasons import remedy  # only a robot with faults pays for it

    remedies = dict.fromkeys(f"remedy   {fault['code']}: {remedy(fault['code'])}" for fault in faults)
    resets = [f"reset    {text}" for text in _reset_texts(status)]
    return [*finding_lines(faults, "fault"), *remedies, *resets]


def _reset_texts(status: StatusMessage) -> list[str]:
    """Return which faults need a reset, and which clear by themselves."""
    codes = list(dict.fromkeys(fault["code"] for fault in status["faults"]))
    # An older daemon reports no latched codes.
    latched = status.get("latched")
    if latched is None:
        latched = codes if status["state"] in RESET_STATES else []
    transient = [code for code in codes if code not in latched]
    texts = []
    if latched:
        torque_on = reported_torque(status)
        live = status["mode"] == Mode.LIVE
        steps = reset_steps(status["state"], latched, torque_on=torque_on, live=live)
        torque = f"{UNKNOWN}; next: " if torque_on is None and live else ""
        texts.append(f"needed for {', '.join(latched)}: {torque}{THEN.join(steps)}")
    if transient:
        names = ", ".join(transient)
        texts.append(f"not needed for {names}: clears once its cause is gone; until then arming is refused")
    return texts


def latency_text(status: StatusMessage) -> str:
    """Format the latency of a whole reading: now, mean, largest, violations."""
    now, mean, most = map(_ms, (status["latency_ms"], status["latency_avg_ms"], status["latency_max_ms"]))
    return f"now {now}, mean {mean}, max {most}; violations {status['violations']}"


def loop_text(loop: LoopMessage) -> str:
    """Format the rate of the loop, lateness and number of missed ticks, and the scheduler."""
    late = f"late p50 {_us(loop['late_p50_us'])}, p99 {_us(loop['late_p99_us'])}"
    total = loop["ticks"] + loop["missed"]
    text = f"{loop['rate_hz']:g} Hz, {late}; {loop['missed']} of {total} ticks missed"
    scheduler = (loop.get("realtime") or {}).get("scheduler")
    if scheduler is None:  # an older daemon
        return text
    if "scheduler" in (loop.get("realtime_denied") or ()):
        scheduler = f"no real time: {scheduler.removeprefix('no: ')}"
    return f"{text}; {scheduler}"


def gap_lines(gap: GapMessage | None) -> list[str]:
    """Format the total gap of the positions; no line without figures."""
    text = gap_text(gap)
    return [] if text is None else [f"gap      {text}"]


def gap_text(gap: GapMessage | None) -> str | None:
    """Format both norms of the positions of all joints; None without figures."""
    total = None if gap is None else gap["total"].get("position")
    if total is None:
        return None
    norms = (("of the spread", total["nrmse_spread"]), ("unexplained", total["unexplained"]))
    shares = [f"{share:.1%} {name}" for name, share in norms if share is not None]
    return ", ".join([f"{total['rms'] * 1e3:.1f} mrad rms", *shares])


def stream_text(report: StreamingMessage) -> str:
    """Format one streamer: endpoint, rate, counts, losses, error."""
    counts = [f"{report['rate_hz']:.4g} Hz", f"{report['sent']} sent", f"{report['waiting']} waiting"]
    lost = (report["dropped"], report["dead"], report["failures"])
    counts += [f"{count} {label}" for count, (_, label) in zip(lost, LOST, strict=True) if count]
    return f"{report['endpoint']}: {', '.join(counts)}" + (f"; {report['error']}" if report["error"] else "")


def joint_lines(joints: Sequence[JointMessage], *, simulated: bool = False) -> list[str]:
    """Format a table of joints; an unknown value is a dash. A simulated joint needs no calibration."""
    rows = [_row(joint, simulated=simulated) for joint in joints]
    return align_columns([COLUMNS, *rows], left=(0, len(COLUMNS) - 1))


def _row(joint: JointMessage, *, simulated: bool) -> tuple[str, ...]:
    notes = [] if joint["heard"] else ["silent"]
    if simulated:
        pass
    elif not joint["calibrated"]:
        notes.append("uncalibrated")
    elif joint.get("verified") is False:
        notes.append("unverified")
    return (
        joint["name"],
        _number(joint["position"], 3),
        _number(joint["goal"], 3),
        _number(joint["velocity"], 2),
        _number(joint["effort"], 2),
        _number(joint["temperature"], 0),
        _number(joint["voltage"], 1),
        _number(joint["age_ms"], 0),
        {True: "on", False: "off", None: "-"}[joint["torque"]],
        ", ".join([*notes, *joint["faults"]]),
    )


def _number(value: float | None, digits: int) -> str:
    return fixed_number(value, digits, "-")


def _ms(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.1f} ms"


def _us(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.0f} µs"


def _status_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--joints", action="store_true", help="a line for every joint too")


def _print_status(options: argparse.Namespace) -> int:
    with observer(options) as client:
        answer = client.call("GetStatus", joints=options.joints or not options.json or None)
    show(options, answer, render(answer["status"], answer.get("joints"), table=options.joints))
    return DONE


STATUS = FunctionVerb(
    "see",
    "Show the state of the daemon and the robot.",
    _status_arguments,
    _print_status,
    supports_remote=True,
)
