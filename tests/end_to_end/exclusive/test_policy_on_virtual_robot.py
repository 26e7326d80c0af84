"""A policy on the virtual robot: pseudo-terminals, a daemon in mode live, a client."""

import os
import time
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")

from tests.support import trained_policy as trained
from tests.support.policy_files import Run, written
from tests.support.processes import Virtual, arm, daemon, robot, until
from tests.support.standing_policy import CARD, bending

SECONDS = float(os.environ.get("POLICY_SECONDS", "4"))
STANDING = 0.4  # m of the base above the floor


@pytest.fixture(params=["bending", pytest.param("learnt", marks=pytest.mark.campaign)])
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A policy file: one that bends the knees to and fro, or that of a test-sized training, 90 s of CPU."""
    if request.param == "learnt":
        return trained.policy(request.config)
    return written(tmp_path, CARD, bending())


def stands(virtual: Virtual) -> bool:
    """On its own feet, and upright enough."""
    body = virtual.order(query="state")["body"]
    return not body["held"] and body["position"][2] > STANDING


def test_a_policy_keeps_the_robot_upright_and_it_stands_on_after_the_policy_is_killed(policy: Path) -> None:
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: stands(virtual), 10.0, "the hands let go")
        run = Run(running, policy)
        try:
            told = run.drives(SECONDS)
            assert told["refused"] == 0 and told["most_tilt_deg"] < 20.0 and told["rate_hz"] > 45.0, told
            assert stands(virtual)
        finally:
            run.kill()
        status = running.reach(motion="holding", lease=None)
        time.sleep(2.0)
        assert status["armed"] and running.status()["armed"] and stands(virtual)
