"""Verbs whose work on a port is a driver family's: `twindctl scan --port` and `twindctl adopt`."""

import argparse

from twind.command_line.verb import DONE, Rejected, UsageError
from twind.config.driver_family import DriverFamily, families
from twind_calibration.robot_description import read


def scan(options: argparse.Namespace) -> int:
    """Search a port for devices of every family, or of `--kind`; return the worst exit code of those found.

    Raises Rejected: no family found a device; UsageError: no such family.
    """
    scanners = [each for each in reversed(families()) if each.scan is not None]
    chosen = [each for each in scanners if options.kind in (None, each.kind)]
    if not chosen:
        raise UsageError(f"--kind {options.kind}: a scan knows {', '.join(each.kind for each in scanners)}")
    codes: list[int] = []
    for each in chosen:
        assert each.scan is not None
        try:
            codes.append(each.scan.load()(options))
        except Rejected:
            if each is chosen[-1] and not codes:
                raise
    return max(codes, default=DONE)


def adopt(options: argparse.Namespace) -> int:
    """Configure a new device by the family of its joint, else of the robot's first bus that can adopt.

    Raises Rejected, UsageError.
    """
    robot = read(options).robot
    joints = {name: joint for joint in robot.joints for name in (joint.actuator, joint.name)}
    joint = joints.get(options.joint)
    kinds = [bus.kind for bus in robot.buses] if joint is None else [joint.type.BUS]
    able = [each for each in reversed(families()) if each.adopt is not None]
    chosen: DriverFamily | None = next((each for kind in kinds for each in able if each.kind == kind), None)
    part = (chosen or able[0]).adopt
    assert part is not None
    return part.load()(options)
