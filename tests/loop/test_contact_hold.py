"""A hand that presses a moving robot is found and holds it; ordinary motions do not. Virtual time."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pytest

from tests.support.contact_rig import ContactRig
from twind.robot.arrays import Floats
from twind.robot.modes import Motion

PRESS = 0.4  # s
STILL = 0.05  # rad/s: two steps of a velocity register


class Press(NamedTuple):
    """Times in s; inf: never."""

    torque: float
    found: float  # after the press
    held: float  # after it was found: the executor holds
    rested: float  # after it was found: all joints at rest


@contextmanager
def dancing(hold_nm: float) -> Iterator[ContactRig]:
    ContactRig.hold_nm = hold_nm
    rig = ContactRig()
    try:
        rig.arm()
        yield rig
    finally:
        rig.close()


def touched(rig: ContactRig, joint: int) -> bool:
    rules = rig.loop.parts.guard.contact
    return bool(rules.touched[joint])


def pressed(rig: ContactRig, rng: np.random.Generator, torque: float) -> Press:
    """Press one joint in a dance at a random time; the robot holds at 0.3 N·m."""
    joint = int(rng.integers(len(rig.names)))
    rig.lease()
    rig.dance(6.0, int(rng.integers(1 << 31)))
    rig.seconds(float(rng.uniform(0.5, 4.0)))
    assert rig.loop.executor.motion is Motion.ACTIVE, rig.events()[-2:]
    rig.news.clear()
    rig.press(rig.names[joint], torque * float(rng.choice([-1.0, 1.0])))
    found, held, rested = np.inf, np.inf, np.inf
    for tick in range(round(PRESS / rig.loop.robot.period)):
        rig.ticks(1)
        now = (tick + 1) * rig.loop.robot.period
        if found == np.inf and (touched(rig, joint) or rig.events("CONTACT_HOLD")):
            found = now
        if found < np.inf and held == np.inf and rig.loop.executor.motion is Motion.HOLDING:
            held = now - found
        if held < np.inf and rested == np.inf and np.abs(rig.loop.robot.measured.velocity).max() < STILL:
            rested = now - found
    return Press(torque, found, held, rested)


def presses(count: int, torques: list[float], hold_nm: float, seed: int) -> list[Press]:
    rng = np.random.default_rng(seed)
    made = []
    for at in range(count):
        with dancing(hold_nm) as rig:  # a new robot: 5 N·m are more than a servo holds (OVERCURRENT)
            made.append(pressed(rig, rng, torques[at % len(torques)]))
    return made


def summary(made: list[Press]) -> str:
    rows = []
    for torque in sorted({each.torque for each in made}):
        some = [each for each in made if each.torque == torque]
        columns: Floats = np.array([(each.found, each.held, each.rested) for each in some]) * 1e3
        known = [column[np.isfinite(column)] for column in columns.T]
        shown = [np.quantile(each, [0.5, 0.95, 1.0]).round().tolist() for each in known if each.size]
        found = f"{known[0].size} of {len(some)}"
        rows.append(f"{torque} N·m: {found}; ms until found, held, at rest (p50, p95, max): {shown}")
    return "\n".join(rows)


@pytest.mark.parametrize(("count", "seed"), [(3, 1), pytest.param(80, 2, marks=pytest.mark.campaign)])
def test_press_is_found_and_holds_the_robot(count: int, seed: int) -> None:
    made = presses(count, [2.0] if count < 10 else [0.5, 1.0, 2.0, 5.0], 0.3, seed)
    print(summary(made))
    strong = [each for each in made if each.torque >= 2.0]
    assert np.mean([each.found < np.inf for each in strong]) >= 0.95, summary(made)
    assert max(each.held for each in strong if each.found < np.inf) <= 0.05, summary(made)


@pytest.mark.parametrize("seconds", [12.0, pytest.param(3600.0, marks=pytest.mark.campaign)])
def test_ordinary_motions_cause_no_contact(seconds: float) -> None:
    with dancing(1.0) as rig:
        for seed in range(round(seconds / 12.0)):
            rig.lease()
            ticket = rig.dance(11.0, seed)
            rig.seconds(12.0)
            assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded", rig.replies(ticket)[-1]
            assert not rig.events("CONTACT"), (seed, rig.events("CONTACT"))
            assert not rig.events("CONTACT_HOLD")
            rig.news.clear()
