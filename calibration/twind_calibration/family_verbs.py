"""Verbs whose work on a port is a driver family's: `twindctl scan --port`, `adopt` and `robot servo`."""

import argparse
import sys

from twind.command_line.verb import DONE, Rejected, UsageError
from twind.config.driver_family import DriverFamily, families
from twind_calibration.robot_description import read


def scan(options: argparse.Namespace) -> int:
    """Search a port family after family until one finds a device, or for `--kind`; return its exit code.

    A bus has devices of one kind, and a search of all rates takes many seconds. Raises Rejected: no family
    found a device; UsageError: no such family.
    """
    scanners = sorted((each for each in reversed(families()) if each.scan is not None), key=_is_slow)
    chosen = [each for each in scanners if options.kind in (None, each.kind)]
    if not chosen:
        raise UsageError(f"--kind {options.kind}: a scan knows {', '.join(each.kind for each in scanners)}")
    for each in chosen:
        assert each.scan is not None
        try:
            code = each.scan.load()(options)
        except Rejected:
            if each is chosen[-1]:
                raise
            continue
        rest = chosen[chosen.index(each) + 1 :]
        if rest and not options.json:
            print(f"not searched: --kind {', '.join(other.kind for other in rest)}", file=sys.stderr)
        return code
    return DONE


def _is_slow(driver: DriverFamily) -> bool:
    """Return True if a search asks each id singly: such families come last."""
    return driver.tools is None or not driver.tools.load().protocol.slot


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


def relocate(options: argparse.Namespace) -> int:
    """Give servos of a port other ids or rates; which family they are of, a scan finds.

    Raises Rejected, UsageError.
    """
    part = next(each.relocate for each in families() if each.relocate is not None)
    assert part is not None
    return part.load()(options)
