"""A daemon that dies at a random moment leaves an arm without watchdogs that goes on by its lead at most."""

import random

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import Mode

ARM = "so101"
LIMIT = 0.15  # rad, `lead_limit_rad`
BRAKES = 0.06  # rad that a goal goes on while it brakes: 1.3 rad/s, 15 rad/s²
ROLL = 5  # id of the wrist


def dies(rig: Rig, dice: random.Random) -> tuple[float, float]:
    """Kill the daemon in a motion, free the joint; how far the goals led, and the joints then went (rad)."""
    blocked = dice.random() < 0.5
    rig.lease()
    target = dice.choice((1.2, -1.2))
    path = rig.path("wrist_roll", [target], [abs(target - rig.truth[ROLL - 1]) / 0.65 + 0.5])
    ticket = rig.submit(path, more=True)
    moves = dice.randrange(10, 150)
    rig.ticks(moves)
    if blocked:
        rig.virtual["main"].faults.lock(ROLL)
    rig.ticks(dice.randrange(1, 100))
    assert rig.replies(ticket)[0].error is None, rig.replies(ticket)
    place = rig.truth
    led = float(np.abs(rig.loop.robot.written - place).max())
    rig.virtual["main"].faults.free(ROLL)
    for _ in range(100):  # nothing writes any more
        rig.clock.time += 0.01
        went = float(np.abs(rig.truth - place).max())
    assert went <= LIMIT + (BRAKES if blocked else 0.0), (led, went, blocked)
    return led, went


def restart(rig: Rig) -> None:
    """Another daemon on the same servos: it inherits the torque and moves nothing until it is armed."""
    rest = rig.truth
    rig.loop.close()
    rig.front = rig.new_front()
    rig.loop = rig.born(Mode.LIVE)
    rig.next_tick = rig.clock.now()
    rig.seconds(1.0)
    assert np.abs(rig.truth - rest).max() < 0.002
    assert rig.call(link.AcquireLease).error is None
    reply = rig.call(link.Arm)
    assert reply.error is None, reply
    assert np.abs(rig.truth - rest).max() < 0.01


@pytest.mark.parametrize("count", [4, pytest.param(60, marks=pytest.mark.campaign)])
def test_no_joint_goes_further_than_its_lead_after_a_kill(make_rig: MakeRig, count: int) -> None:
    rig: Rig = make_rig(ARM)
    dice = random.Random(20261128)
    rig.arm()
    seen = []
    for _ in range(count):
        seen.append(dies(rig, dice))
        restart(rig)
    led, went = map(max, zip(*seen, strict=True))
    assert led > 0.1  # the limit was reached
    print(f"{count} kills: goals led by {led:.3f} rad at most, joints went on by {went:.3f} rad at most")
