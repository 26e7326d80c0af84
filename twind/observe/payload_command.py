"""Estimate a mass that the robot holds.

Needs an identified model, and a robot that is armed and holds still or moves slowly. The mass is taken to sit
at the centre of the named body.
"""

import argparse
from math import isfinite

from twind.command_line.verb import DONE, Rejected, UsageError, observer, show

group = "see"

RATE = 50.0  # Hz
LONGEST = 60.0  # s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add body and time."""
    parser.add_argument("body", metavar="BODY", help="body of the model that holds the mass, such as a hand")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="of readings (default 2)")


def run(options: argparse.Namespace) -> int:
    """Print the mass; 0. Raises UsageError, Rejected, ClientError."""
    if not (isfinite(options.seconds) and 0.0 < options.seconds <= LONGEST):
        raise UsageError(f"--seconds {options.seconds:g}: above 0, at most {LONGEST:g}")
    import numpy as np

    from twind.exceptions import InvalidInput
    from twind.robot_client.daemon_robot_file import robot_file_of
    from twind.twin.binding import bind
    from twind.twin.payload_estimate import estimate_payload

    rows = []
    with observer(options) as client:
        answer = client.call("GetRobot")
        begin = None
        for message in client.stream("Monitor", topics=["state"], rate=RATE):
            begin = message["time"] if begin is None else begin
            joints = message["joints"]
            keys = ("position", "external_nm", "external_sd_nm")
            row = [[joint.get(key) for joint in joints] for key in keys]
            if not any(value is None for column in row for value in column):
                rows.append(np.array(row, np.float64))
            if message["time"] - begin >= options.seconds:
                break
    if not rows:
        raise Rejected(
            "no torque from outside is known: it needs mode live, torque, and an identified model "
            "(twindctl identify) of a robot that does not stand on its feet; each servo reports its current, "
            "or has a P gain and no I gain"
        )
    positions, torques, deviations = zip(*rows, strict=True)
    try:
        binding = bind(robot_file_of(answer), None)
        found = estimate_payload(binding, options.body, positions, torques, deviations)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    text = f"{options.body}: {found.mass_kg:.3f} ± {2.0 * found.sd_kg:.3f} kg (95 %)"
    if not found.determined:
        text += "; not determined: stretch the arm sideways, move it slowly meanwhile, or identify its joints"
    result = {
        "body": options.body,
        "mass_kg": found.mass_kg,
        "sd_kg": found.sd_kg,
        "determined": found.determined,
    }
    show(options, result, text)
    return DONE
