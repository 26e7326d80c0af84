"""A waist of 1.5 motor turns, of which no place determines the turn by its count."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import pi
from pathlib import Path

from tests.support.daemon_rig import Rig
from tests.support.planar_arm import WAIST, waist_in
from twind import link
from twind.config.robot_file import load_robot
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind.virtual.virtual_robot_spec import calibration, make_spec

RATIO = 3.0
TURN = 2.0 * pi / RATIO  # rad of the joint
STOP = 1.64  # rad, described
PLAIN = JointGroundTruth(stops_rad=(-STOP, STOP))


def long_waist_in(folder: Path, ratio: float = RATIO) -> str:
    """Its robot file."""
    return waist_in(folder, ratio, f", stop_rad: {{lower: -{STOP:g}, upper: {STOP:g}}}")


@contextmanager
def started(waist: str, angle: float, truth: JointGroundTruth = PLAIN) -> Iterator[Rig]:
    """A daemon whose robot's waist stands there, calibrated as it is; connected, leased, calibrating."""
    known = load_robot(waist)
    plain = calibration(make_spec(known, truth=RobotGroundTruth({WAIST: PLAIN})))
    rig = Rig(waist, truth=RobotGroundTruth({WAIST: truth}), calibrated=plain, start={WAIST: angle})
    try:
        rig.connect()
        rig.lease()
        assert rig.call(link.Calibrate, on=True).error is None
        yield rig
    finally:
        rig.close()
