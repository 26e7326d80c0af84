"""A carded policy: its network with its recurrent state, and the actor that drives one robot with it."""

from collections.abc import Mapping
from contextlib import AbstractContextManager

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.cards.card_observer import CardObserver
from twind.learn.cards.interface_card import InterfaceCard
from twind.learn.policy.onnx_session import OnnxSession, Rows, TensorEnd
from twind.learn.policy.policy_actor import Action
from twind.learn.task.observation import BodyReading, Observations
from twind.robot.arrays import Floats, frozen
from twind.robot.joint_limits import JointLimits

FLOAT = "tensor(float)"
MARGIN = 1e-6  # rad that targets keep from the limits: rounding would else put a setpoint beyond them


class CardPolicy:
    """Network and card of a file. Keeps its recurrent state; not for several threads at once."""

    def __init__(self, card: InterfaceCard, session: OnnxSession) -> None:
        """Raises InvalidInput where the network's names or shapes are not the card's."""
        self.card = card
        self._session = session
        # Positions and names of the robot change no shape.
        joints = card.named_joints
        observer = CardObserver(card, joints, np.zeros(len(joints)))
        self.shapes = {name: each.shape for name, each in observer.inputs.items()}
        states = {name: state.shape for name, state in card.state.items()}
        inputs = {end.name: end for end in session.inputs}
        outputs = {end.name: end for end in session.outputs}
        _require_names("input", inputs, {**self.shapes, **states}, exact=True)
        kept = {state.output: state.shape for state in card.state.values()}
        wanted: dict[str, tuple[int, ...]] = {card.action.output: (1, len(card.joints)), **kept}
        _require_names("output", outputs, wanted, exact=False)
        self._flat = {name: len(inputs[name].shape) == 1 for name in self.shapes}
        self._outputs = list(wanted)
        self._state: dict[str, Rows] = {}
        self.begin()

    def begin(self) -> None:
        """Set the recurrent state to zero."""
        self._state = {name: np.zeros(each.shape, np.float32) for name, each in self.card.state.items()}

    def act(self, observations: Mapping[str, Observations]) -> Action:
        """Return the action (m,) as the network gives it, and keep the state. Raises InvalidInput."""
        seen = {name: row[0] if self._flat[name] else row for name, row in observations.items()}
        found = dict(
            zip(self._outputs, self._session.infer(self._outputs, {**seen, **self._state}), strict=True)
        )
        for name, state in self.card.state.items():
            after = found[state.output]
            if after.shape != self._state[name].shape or not np.isfinite(after).all():
                raise InvalidInput(f"its state {state.output} is {after.shape} or not finite")
            self._state[name] = after
        action = found[self.card.action.output].reshape(-1)
        if action.shape != (len(self.card.joints),):
            raise InvalidInput(
                f"its action has {action.size} numbers, its card {len(self.card.joints)} joints"
            )
        return action

    def zeros(self) -> dict[str, Observations]:
        """Observations of zeros."""
        return {name: np.zeros(shape, np.float32) for name, shape in self.shapes.items()}

    def ending_long_inferences(self) -> AbstractContextManager[None]:
        """End each inference that takes more than a second: `act` then raises InvalidInput."""
        return self._session.ending_long_inferences()


class CardTargets:
    """Targets of a carded policy (n,), rad. The loop moves to them within its limits and reports delays."""

    def __init__(self, limits: JointLimits, default: Floats, reach: tuple[Floats, Floats] | None) -> None:
        """`reach`: lowest and highest target that the clipped action can ask for; None: no clip.

        Of a joint whose reach lies beyond its limits, the nearest limit is the only target.
        """
        self.default = frozen(default)
        self.reach = reach
        low, high = (limits.lower, limits.upper) if reach is None else reach
        self.lower = frozen(np.clip(low, limits.lower + MARGIN, limits.upper - MARGIN))
        self.upper = frozen(np.clip(high, limits.lower + MARGIN, limits.upper - MARGIN))
        self.velocity = limits.velocity
        self.target = default.copy()
        self.clipped = 0  # targets that the action put beyond the limits

    def coast(self, periods: int) -> None:
        """Keep the target: the loop goes there by itself."""


class CardActor:
    """A carded policy on one robot."""

    def __init__(
        self, policy: CardPolicy, joints: tuple[str, ...], limits: JointLimits, default: Floats
    ) -> None:
        """`joints`, `default`: of the robot; joints that the card does not name keep the default.

        Raises InvalidInput where the card does not fit.
        """
        self.policy = policy
        card = policy.card
        require_card_fit(card, joints, limits)
        self.joints = joints
        self.period = card.period
        self._card = card
        pose = default_pose(card, joints, default)
        self._moved = np.array([joints.index(name) for name in card.joints])
        sign = np.array([float(card.signs.get(name, 1)) for name in card.joints])
        self._scale = sign * np.array([card.scale(name) for name in card.joints])
        self._origin = pose[self._moved] * (card.action.offset == "default")
        self._observer = CardObserver(card, joints, pose)
        self.shaper = CardTargets(limits, pose, self._reach(pose))
        self.begin()

    def begin(self, goal: Floats | None = None) -> None:
        """Begin at rest: the recurrent state is zero and the history empty."""
        self.policy.begin()
        place = self.shaper.default if goal is None else goal
        self.shaper.target = np.minimum(np.maximum(place, self.shaper.lower), self.shaper.upper)
        self._observer.begin(None if goal is None else (goal[self._moved] - self._origin) / self._scale)

    def act(self, reading: BodyReading, command: Floats, step: int) -> Action | str:
        """Return the clipped action (m,), in the order of the card."""
        seen = self._observer.observe(reading, self.shaper.target, command, step)
        if isinstance(seen, str):
            return seen
        action = self.policy.act(seen)
        finite = np.isfinite(action)
        if not finite.all():
            return f"the action of {self._card.joints[int(np.argmin(finite))]} is not finite"
        bounds = self._card.action.clip
        return action if bounds is None else np.clip(action, *bounds)

    def shape(self, action: Action) -> tuple[Floats, Floats]:
        """Return the target, within the limits, and the velocity to it: 0 with `path: hold`."""
        self._observer.record(action.astype(np.float64))
        shaper = self.shaper
        wanted = shaper.default.copy()
        wanted[self._moved] = self._origin + self._scale * action
        target = np.minimum(np.maximum(wanted, shaper.lower), shaper.upper)
        shaper.clipped += int((np.abs(target - wanted) > 2.0 * MARGIN).sum())
        before = shaper.target
        shaper.target = target
        if self._card.action.path == "hold":
            return target, np.zeros(len(target))
        velocity = np.clip((target - before) / self.period, -shaper.velocity, shaper.velocity)
        return before + velocity * self.period, velocity

    def _reach(self, pose: Floats) -> tuple[Floats, Floats] | None:
        """Lowest and highest target of each joint (n,) that the clipped action asks for."""
        bounds = self._card.action.clip
        if bounds is None:
            return None
        ends = self._origin + np.outer(bounds, self._scale)
        low = pose.copy()
        high = pose.copy()
        low[self._moved] = ends.min(axis=0)
        high[self._moved] = ends.max(axis=0)
        return low, high


def default_pose(card: InterfaceCard, joints: tuple[str, ...], default: Floats) -> Floats:
    """Return the pose (n,), rad, of the robot: the card's, else `default` of it."""
    pose = default.copy()
    for name, position in card.default_rad.items():
        pose[joints.index(name)] = card.signs.get(name, 1) * position
    return pose


def require_card_fit(card: InterfaceCard, joints: tuple[str, ...], limits: JointLimits) -> None:
    """Raises InvalidInput unless the robot has the card's joints, and its limits the default pose."""
    missing = [name for name in (*card.named_joints, *card.default_rad) if name not in joints]
    if missing:
        unknown = ", ".join(dict.fromkeys(missing))
        raise InvalidInput(f"its card names {unknown}, the robot has {', '.join(joints)}: use its names")
    for name, position in card.default_rad.items():
        at = joints.index(name)
        value = card.signs.get(name, 1) * position
        low = float(limits.lower[at])
        high = float(limits.upper[at])
        if not low <= value <= high:
            bounds = f"the robot allows {low:g}..{high:g}: check sign and default_rad"
            raise InvalidInput(f"its card: default of {name} is {value:g} rad, {bounds}")


def _require_names(
    what: str, ends: Mapping[str, TensorEnd], wanted: Mapping[str, tuple[int, ...]], *, exact: bool
) -> None:
    """Raises InvalidInput unless the network has the wanted ends with their shapes, and inputs no others."""
    missing = [name for name in wanted if name not in ends]
    other = [name for name in ends if name not in wanted]
    if missing or (exact and other):
        has = ", ".join(name[:40] for name in list(ends)[:8]) or "none"
        raise InvalidInput(f"the network has the {what}s {has}; its card names {', '.join(wanted)}")
    for name, shape in wanted.items():
        end = ends[name]
        if end.type != FLOAT:
            raise InvalidInput(f"its {what} {name} is a {end.type}, float32 is needed: cast it in the export")
        if not _fits(end.shape, shape):
            raise InvalidInput(
                f"its {what} {name} has the shape {end.shape}, by its card {list(shape)}: compare terms, "
                "history and joints with the training"
            )


def _fits(found: list[int | str | None], wanted: tuple[int, ...]) -> bool:
    """Every size is the wanted one or dynamic; a batch of 1 may be absent."""
    sizes = wanted[1:] if len(found) == len(wanted) - 1 and wanted[0] == 1 else wanted
    return len(found) == len(sizes) and all(
        not isinstance(size, int) or size == expected for size, expected in zip(found, sizes, strict=True)
    )
