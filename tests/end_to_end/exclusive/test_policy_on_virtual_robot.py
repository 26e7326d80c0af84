"""A policy learnt in simulation on the virtual robot: pseudo-terminals, a daemon in mode live, a client."""

import os
import time
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")

from tests.support import trained_policy as trained
from tests.support.policy_files import Run
from tests.support.processes import Virtual, arm, daemon, robot, until

SECONDS = float(os.environ.get("POLICY_SECONDS", "10"))
STANDING = 0.4  # m of the base above the floor


@pytest.fixture(scope="module")
def learnt(request: pytest.FixtureRequest) -> Path:
    """The policy file of a test-sized training."""
    return trained.policy(request.config)


def stands(virtual: Virtual) -> bool:
    """On its own feet, and upright enough."""
    body = virtual.order(query="state")["body"]
    return not body["held"] and body["position"][2] > STANDING


@pytest.mark.slow  # the policy is trained first, 90 s of CPU, unless a computed test has done that
def test_a_policy_keeps_the_robot_upright_and_it_stands_on_after_the_policy_is_killed(learnt: Path) -> None:
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: stands(virtual), 10.0, "the hands let go")
        run = Run(running, learnt)
        try:
            told = run.drives(SECONDS)
            assert told["refused"] == 0 and told["most_tilt_deg"] < 20.0 and told["rate_hz"] > 45.0, told
            assert stands(virtual)
        finally:
            run.kill()
        status = running.reach(motion="holding", lease=None)
        time.sleep(2.0)
        assert status["armed"] and running.status()["armed"] and stands(virtual)
