"""A policy on the virtual robot: pseudo-terminals, a daemon in mode live, a client."""

import os
import time
from pathlib import Path

import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import Run, written
from tests.support.processes import Virtual, arm, daemon, robot, until
from tests.support.standing_policy import CARD, bending

SECONDS = float(os.environ.get("POLICY_SECONDS", "10"))
STANDING = 0.4  # m of the base above the floor


CASES = (
    pytest.param("bends its knees", marks=pytest.mark.slow),
    pytest.param("learnt", marks=pytest.mark.campaign),
)


@pytest.fixture(params=CASES)
def driving(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, float]:
    """A policy file, and the seconds that it drives; the learnt one comes from a test-sized training."""
    if request.param != "learnt":
        return written(tmp_path, CARD, bending()), 6.0
    pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")
    from tests.support import trained_policy as trained

    return trained.policy(request.config), SECONDS


def stands(virtual: Virtual) -> bool:
    """On its own feet, and upright enough."""
    body = virtual.order(query="state")["body"]
    return not body["held"] and body["position"][2] > STANDING


def test_a_policy_keeps_the_robot_upright_and_it_stands_on_after_the_policy_is_killed(
    driving: tuple[Path, float],
) -> None:
    policy, seconds = driving
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: stands(virtual), 10.0, "the hands let go")
        run = Run(running, policy)
        try:
            told = run.drives(seconds)
            assert told["refused"] == 0 and told["most_tilt_deg"] < 20.0 and told["rate_hz"] > 45.0, told
            assert stands(virtual)
        finally:
            run.kill()
        status = running.reach(motion="holding", lease=None)
        time.sleep(2.0)
        assert status["armed"] and running.status()["armed"] and stands(virtual)
