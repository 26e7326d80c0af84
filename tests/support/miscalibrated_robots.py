"""Robots that were calibrated as one thing and are found as another; every tick is watched."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind.virtual.virtual_robot_spec import calibration, make_spec

KNEE = "l_knee"
TURN = 4096
PLAIN = JointGroundTruth()
OPEN = {"min_position_limit": 0, "max_position_limit": 4095}  # as delivered: no fingerprint


class Planted(Rig):
    """A robot that was calibrated as `before` and is found as `found`. Every tick is watched."""

    def __init__(
        self,
        before: Mapping[str, JointGroundTruth],
        found: Mapping[str, JointGroundTruth],
        robot: str = "h24",
        **how: Any,
    ) -> None:
        self.energised: set[str] = set()  # joints that had torque at any tick
        self.moved = 0.0  # ticks, the furthest that any shaft was from where it began
        self._began: np.ndarray | None = None
        then = calibration(make_spec(load_robot(robot), truth=RobotGroundTruth(before)))
        super().__init__(robot, truth=RobotGroundTruth(found), calibrated=then, **how)

    def ticks(self, count: int) -> None:
        """Let `count` ticks pass, looking after each."""
        for _ in range(count):
            super().ticks(1)
            self.look()

    def look(self) -> None:
        """Note the joints with torque and the largest move so far, counts."""
        on = self.register("torque_enable") != 0
        self.energised |= {self.names[row] for row in np.flatnonzero(on)}
        if self._began is None:
            self._began = self.counts
        self.moved = max(self.moved, float(np.abs(self.counts - self._began).max()))

    def hand(self, **pose: float) -> None:
        """Somebody takes limp joints there, and lets go of them."""
        faults = self.virtual["main"].faults
        faults.hand(pose=pose, speed=3.0)
        self.seconds(1.5)
        faults.hand(off=True)
        self._began = None
        self.moved = 0.0

    def id_of(self, joint: str) -> int:
        return self.robot.joints[self.names.index(joint)].id

    def refused(self, *, ticks: int = 150) -> list[tuple[str, str, str]]:
        """Code, joint and words of all that the daemon has against torque, after it was asked for it.

        Nobody had torque meanwhile, and nothing moved.
        """
        self.ticks(ticks)
        self.call(link.AcquireLease)
        reply = self.call(link.Arm)
        assert reply.error is not None, "armed"
        self.ticks(20)
        assert not self.loop.torque.armed
        assert self.energised == set(), "torque was on"
        assert self.moved <= 1.0, "something moved"
        return self.reported_findings(reply.parameters.get("findings", ()))

    def reported_findings(self, findings: Any = ()) -> list[tuple[str, str, str]]:
        """Findings (code, joint, message) of a reply, and of every event so far."""
        found = [(str(each["code"]), each["joint"], each["message"]) for each in findings]
        for event in self.events():
            found += [(str(each.code), each.joint, each.message) for each in event.findings]
        return [(code, "" if at is None else self.names[at], text) for code, at, text in found]


def names_it(findings: list[tuple[str, str, str]], code: str, joint: str, *words: str) -> bool:
    """Check for a finding of this code and joint whose message has all words."""
    return any(
        (kind, at) == (code, joint) and all(word in text for word in words) for kind, at, text in findings
    )


@pytest.fixture(scope="module")
def floating(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of an h24 whose left knee is in extended position mode."""
    built_in = load_robot("h24")
    text = built_in.path.read_text().replace("mjcf: h24.xml", f"mjcf: {built_in.mjcf_path}")
    head, _, rest = text.partition(f"  {KNEE}:")
    text = f"{head}  {KNEE}:{rest.replace('{', '{mode: extended_position, ', 1)}"
    path: Path = tmp_path_factory.mktemp("floating") / "h24.yaml"
    path.write_text(text)
    return str(path)


@pytest.fixture
def plant() -> Iterator[Any]:
    """Makes planted robots, and puts them away."""
    made: list[Planted] = []

    def one(before: JointGroundTruth, found: JointGroundTruth, robot: str = "h24", **how: Any) -> Planted:
        made.append(Planted({KNEE: before}, {KNEE: found}, robot, **how))
        return made[-1]

    yield one
    for each in made:
        each.close()
