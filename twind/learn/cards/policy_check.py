"""Check of a policy before a robot is touched: fit, test vectors, time, numbers, a drive in simulation."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from time import perf_counter, thread_time
from typing import NamedTuple

import mujoco
import numpy as np

from twind.config.robot_file import RobotFile
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardActor, CardPolicy
from twind.learn.cards.driven_policy import AnyPolicy, actor_for, task_for
from twind.learn.cards.policy_rollout import RolloutResult, roll_out
from twind.learn.cards.vector_replay import replay_vectors
from twind.learn.environment.sim_body import SimBody
from twind.learn.policy.policy_actor import PolicyActor
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.policy.policy_controller import LATE
from twind.learn.randomise.randomisation_ranges import RandomisationRanges
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant, plant_of
from twind.learn.video.video_writer import FPS, VideoWriter
from twind.robot.arrays import Floats

CALLS = 300  # inferences that are timed, after some that warm up
WARM = 20


class CheckLine(NamedTuple):
    """One result: `ok`, `warn` or `fail`, of what, and its figures."""

    verdict: str
    name: str
    text: str


@dataclass(slots=True)
class CheckSettings:
    """Settings of a check."""

    command: Floats  # (3,)
    seconds: float  # of the drive in simulation
    folder: Path  # of the card
    robot: RobotFile
    film: Path | None = None  # video of the drive


def check_policy(policy: AnyPolicy, settings: CheckSettings) -> Iterator[CheckLine]:
    """Yield the results one after another; the check ends at a `fail` that leaves nothing to go on with."""
    robot = settings.robot
    try:
        plant = plant_of(robot, period=1.0 / robot.rate_hz, looks=settings.film is not None)
        limits = plant.binding.limits
        described = PolicyRobot.from_limits(robot.name, plant.layout, limits, robot.rate_hz)
        actor = actor_for(policy, described, plant.default)
    except InvalidInput as error:
        yield CheckLine("fail", "robot", str(error))
        return
    ticks = round(robot.rate_hz * actor.period)
    rate = f"{1.0 / actor.period:g} actions per second, {ticks} ticks of the loop each"
    yield CheckLine("ok", "robot", f"{robot.name}: {len(actor.joints)} joints; {rate}")
    if isinstance(policy, CardPolicy):
        yield from _reach(actor, plant)
        yield _vectors(policy, settings.folder)
    try:
        yield _time(actor, plant, settings.command)
    except InvalidInput as error:
        yield CheckLine("fail", "inference", str(error))
        return
    body = SimBody(plant, RandomisationRanges(), 1.0 / robot.rate_hz)
    with _filming(settings.film, body, actor.period) as look:
        done = roll_out(actor, plant, body, task_for(policy), settings.command, settings.seconds, look=look)
    yield from _rollout(done, settings)


@contextmanager
def _filming(path: Path | None, body: SimBody, period: float) -> Iterator[Callable[[SimBody], None]]:
    """Give what sees each period: it draws `FPS` of them a second. Raises OperationFailed."""
    if path is None:
        yield lambda body: None
        return
    every = max(1, round(1.0 / (FPS * period)))
    steps = count(0)
    data = mujoco.MjData(body.model)
    with closing(
        VideoWriter(path, body.model, body.plant.binding.robot.base, 1.0 / (every * period))
    ) as video:

        def look(body: SimBody) -> None:
            if next(steps) % every == 0:
                data.qpos[:] = body.data.qpos  # drawing works on a copy
                video.add(data)

        yield look


def _reach(actor: PolicyActor, plant: Plant) -> Iterator[CheckLine]:
    """Compare the limits with all that the clipped action can ask for."""
    limits = plant.binding.limits
    wanted = actor.shaper.reach if isinstance(actor, CardActor) else None
    if wanted is None:
        yield CheckLine("ok", "limits", "they admit the default pose; the card gives no action.clip")
        return
    low, high = wanted
    beyond = np.maximum(limits.lower - low, high - limits.upper)
    names = [f"{actor.joints[at]} by {beyond[at]:.2f} rad" for at in np.argsort(-beyond) if beyond[at] > 1e-9]
    if names:
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        yield CheckLine(
            "warn", "limits", f"action.clip reaches beyond them: {', '.join(names[:3])}{more}; cut"
        )
    else:
        yield CheckLine("ok", "limits", "they admit the default pose and all of action.clip")


def _vectors(policy: CardPolicy, folder: Path) -> CheckLine:
    spec = policy.card.test
    if spec is None:
        return CheckLine("warn", "vectors", "none: `test: {file: NAME.npz}` proves that the export is right")
    try:
        steps, worst = replay_vectors(policy, spec, folder)
    except InvalidInput as error:
        return CheckLine("fail", "vectors", str(error))
    verdict = "ok" if worst <= spec.tolerance else "fail"
    text = f"{steps} steps, the actions differ by at most {worst:.2g}, tolerance {spec.tolerance:g}"
    return CheckLine(verdict, "vectors", text)


def _time(actor: PolicyActor, plant: Plant, command: Floats) -> CheckLine:
    """Time of actions on random readings, and whether all are finite. Raises InvalidInput."""
    rng = np.random.default_rng(0)
    times = []
    work = []  # s of CPU: other programs do not count
    for number in range(WARM + CALLS):
        reading = BodyReading.empty(len(actor.joints))
        reading.values[...] = rng.normal(0.0, 1.0, reading.values.shape)
        reading.position[...] = plant.default + rng.normal(0.0, 0.3, len(actor.joints))
        reading.gravity[...] /= np.linalg.norm(reading.gravity)
        began = perf_counter()
        before = thread_time()
        action = actor.act(reading, command, number)
        work.append(thread_time() - before)
        times.append(perf_counter() - began)
        if isinstance(action, str):
            return CheckLine("fail", "inference", f"{action}, for a random observation")
        actor.shape(action)
    actor.begin()
    p50, p99 = np.quantile(np.array(times[WARM:]) * 1e3, (0.5, 0.99)).tolist()
    used = float(np.quantile(np.array(work[WARM:]), 0.99)) * 1e3
    bound = LATE * actor.period * 1e3
    text = f"p50 {p50:.3f} ms, p99 {p99:.3f} ms, of CPU p99 {used:.3f} ms, one thread; bound {bound:g} ms"
    verdict = "fail" if used > bound else "warn" if p99 > bound else "ok"
    return CheckLine(verdict, "inference", text)


def _rollout(done: RolloutResult, settings: CheckSettings) -> Iterator[CheckLine]:
    reward = done.returned / max(done.steps, 1)
    command = ", ".join(f"{each:g}" for each in settings.command.tolist())
    text = (
        f"{done.seconds:.1f} s of {settings.seconds:g} s, command {command}: return {reward:.3f} per step, "
        f"{done.forward:+.2f} m forward, tilt at most {done.tilt:.0f}°"
    )
    yield CheckLine(
        "fail" if done.ended else "ok", "drive", f"{text}{f'; {done.ended}' if done.ended else ''}"
    )
    steps = max(done.steps, 1)
    refused = ", ".join(f"{name} {times} times" for name, times in done.refused.most_common(3)) or "none"
    yield CheckLine("fail" if done.refused else "ok", "gate", f"refused setpoints: {refused}")
    late = ", ".join(f"{name} in {times / steps:.0%}" for name, times in done.late.most_common(4)) or "never"
    near = ", ".join(f"{pair} in {ticks} ticks" for pair, ticks in done.slowed.most_common(3)) or "none"
    verdict = "warn" if done.slowed else "ok"
    yield CheckLine(verdict, "collision", f"pairs so near that the loop slows the motion: {near}")
    text = f"followed late: {late}; {done.clipped / steps:.2f} targets per step were cut to the limits"
    yield CheckLine("warn" if done.limited else "ok", "limits in motion", text)
