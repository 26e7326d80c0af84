"""Steps of `twindctl tune gains`: connect, try, print, write."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from twind import robots
from twind.command_line.text_table import align_columns
from twind.command_line.verb import Rejected, UsageError, observer, operator, show
from twind.config.robot_file import RobotFile
from twind.ctl.robot_file_edit import RobotFileEdit
from twind.exceptions import InvalidInput
from twind.identification.carried_robot import require_carried
from twind.identification.step_bench import StepBench
from twind.robot_client.daemon_robot_file import robot_file_of
from twind.robot_client.robot import Robot
from twind.tuning.gain_search import Gains, GainSearch, GainTry
from twind.tuning.gain_tuning import TuningResult, tune
from twind.tuning.step_response import LEAST_STEP

HEADINGS = ("try", "gains", "overshoot", "rise", "settling", "remaining", "swings", "IAE", "")
MOST_TRIES = 40


def tune_gains(options: argparse.Namespace, names: Sequence[str]) -> None:
    """Tune the type of these joints. Raises Rejected, UsageError, ClientError."""
    if not (
        options.step >= LEAST_STEP and 0.0 < options.overshoot < 1.0 and 2 <= options.tries <= MOST_TRIES
    ):
        raise UsageError(
            f"--step is at least {LEAST_STEP:g} rad, --overshoot between 0 and 1, --tries 2 to {MOST_TRIES}"
        )
    with observer(options) as client:
        answer = client.call("GetRobot")
    joints = _joints_of_one_type(answer["robot"], names)
    require_carried(answer["robot"], "`tune gains`, which takes its torque for each try,")
    try:
        file = robot_file_of(answer)
        kind = next(joint.type for joint in file.joints if joint.name in joints)
        if options.write:
            _require_writable(file)
        gains = {name: joints[names[0]]["type"]["gains"].get(name) for name in kind.gain_limits}
        if None in gains.values():
            raise InvalidInput(f"types.{kind.name}.gains: state all gains in the robot file, then reload it")
        search = GainSearch(gains, kind.gain_limits, options.overshoot)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    with Robot(options.socket, take=options.take) as robot:
        bench = StepBench(robot, lambda: observer(options), joints, gains, options.step)
        result = tune(bench, list(joints), search, options.tries)
        proposal = result.proposal if options.write else None
    if proposal is not None:
        _write(file, kind.name, proposal.gains)
        with operator(options) as client:
            client.call("Reload")
    _print(options, kind.name, search, result, None if proposal is None else str(file.path))


def _joints_of_one_type(described: Mapping[str, Any], names: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """Return the named joints as described. Raises Rejected."""
    known = {each["name"]: each for each in described["joints"]}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise Rejected(f"no joint {unknown[0]}; there are {', '.join(known)}")
    kinds = dict.fromkeys(known[name]["type"]["name"] for name in names)
    if len(kinds) > 1:
        raise Rejected(f"the joints are of types {', '.join(kinds)}: tune those of one type at a time")
    return {name: known[name] for name in names}


def _require_writable(file: RobotFile) -> None:
    """Raise Rejected for a robot file of the package."""
    if file.path.resolve().parent == Path(robots.__path__[0]).resolve():
        raise Rejected(f"--write: {file.path} is built in: copy it, and start the daemon with the copy")


def _write(file: RobotFile, kind: str, gains: Gains) -> None:
    """Write gains into the robot file. Raises Rejected."""
    edit = RobotFileEdit(file.path)
    section = f"types.{kind}.gains"
    try:
        for name, value in gains.items():
            edit.put(f"{section}.{name}", f"{value:g}")
    except Rejected:  # factory gains, which the file need not state
        edit.put(section, "{" + ", ".join(f"{name}: {value:g}" for name, value in gains.items()) + "}")
    edit.save()


def _print(
    options: argparse.Namespace, kind: str, search: GainSearch, result: TuningResult, written: str | None
) -> None:
    proposal = result.proposal
    data = {
        "type": kind,
        "tries": [_plain(search, each) for each in result.tries],
        "proposal": None if proposal is None else dict(proposal.gains),
        "written": written,
    }
    rows = [HEADINGS, *(_row(place, search, each) for place, each in enumerate(result.tries, 1))]
    lines = align_columns(rows, (1, len(HEADINGS) - 1))
    if proposal is None:
        lines.append(f"types.{kind}.gains: nothing better was found within the bounds")
    else:
        lines.append(f"proposed: types.{kind}.gains: {_text(proposal.gains)}")
    lines.append(
        f"written to {written}, and reloaded" if written else "the gains of the robot file are in force"
    )
    show(options, data, "\n".join(lines))


def _row(place: int, search: GainSearch, tried: GainTry) -> tuple[str, ...]:
    made = tried.response
    if made is None:
        return (str(place), _text(tried.gains), *[""] * 6, tried.stopped)
    return (
        str(place),
        _text(tried.gains),
        f"{made.overshoot:.0%}",
        f"{made.rise:.2f} s",
        f"{made.settling:.2f} s",
        f"{made.steady_error * 1e3:.1f} mrad",
        str(made.swings),
        f"{made.iae * 1e3:.0f} ms",
        "" if search.is_fit(tried) else "overshoots or rings",
    )


def _plain(search: GainSearch, tried: GainTry) -> dict[str, Any]:
    """Return a try for `--json`; null: never reached, or not measured."""
    made = {} if tried.response is None else asdict(tried.response)
    figures = {key: value if isfinite(value) else None for key, value in made.items()}
    return {"gains": dict(tried.gains), **figures, "fit": search.is_fit(tried), "stopped": tried.stopped}


def _text(gains: Gains) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in gains.items())
