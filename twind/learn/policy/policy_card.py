"""The card of a policy file: what it was trained for, and whether a robot matches. No ONNX, no torch.

It is stored in the file's `metadata_props` as JSON under the key `twind`. It may come from an untrusted
source.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import msgspec
import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.task.action_shaping import ActionShaping
from twind.learn.task.observation_layout import ObservationLayout
from twind.protocol import strict_json
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits
from twind.version import __version__

FORMAT = "twind-policy/1"
LARGEST = 1 << 20  # bytes of JSON
MOST_JOINTS = 256
# Steps a second, least and most. A setpoint is followed for at most 0.1 s (`live/setpoint_session.py`), and
# the next one has to reach a tick before that.
RATES = (12.5, 1000.0)
CLOSE = 1e-6  # rad, rad/s, rad/s²: figures nearer than this are the same

Entries = Mapping[str, tuple[int, int]]  # name of a part -> its first and its last entry, in order
_Entry = tuple[str, tuple[int, int]]


@dataclass(frozen=True, slots=True)
class PolicyCard:
    """Properties that a policy was made for. Rows are (n,) in the order of `joints`."""

    task: str
    robot: str  # name of the robot file it was trained on
    joints: tuple[str, ...]
    layout: Entries  # of the observation
    default: tuple[float, ...]  # rad: the pose that action 0 means
    lower: tuple[float, ...]  # rad, rad/s, rad/s²: the limits that targets were shaped within
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    shaping: ActionShaping  # its period and its reach, too
    command: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # name: least, most in training
    trained_steps: int = 0
    evaluation: Mapping[str, float] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)  # whatever else is worth knowing
    format: str = FORMAT
    twind: str = __version__  # that wrote the file

    @classmethod
    def for_training(
        cls,
        task: str,
        robot: str,
        layout: ObservationLayout,
        limits: JointLimits,
        default: Floats,
        shaping: ActionShaping,
        **more: Any,
    ) -> "PolicyCard":
        """Build the card from the settings that a policy is trained with; `more`: the remaining fields."""
        rows = (default, limits.lower, limits.upper, limits.velocity, limits.acceleration)
        pose, lower, upper, velocity, acceleration = (tuple(row.tolist()) for row in rows)
        return cls(
            task=task,
            robot=robot,
            joints=layout.joints,
            layout=entries(layout),
            default=pose,
            lower=lower,
            upper=upper,
            velocity=velocity,
            acceleration=acceleration,
            shaping=shaping,
            **more,
        )

    @property
    def observations(self) -> int:
        """Number of entries of an observation."""
        return 1 + max((last for _, last in self.layout.values()), default=-1)

    @property
    def rate_hz(self) -> float:
        """Control steps per second."""
        return 1.0 / self.shaping.period

    @property
    def limits(self) -> JointLimits:
        """Limits within which the policy's targets are shaped."""
        return limits_of(self.lower, self.upper, self.velocity, self.acceleration)

    def text(self) -> str:
        """Return the card as JSON. Raises InvalidInput for a card that could not be read again."""
        text = msgspec.json.encode(asdict(self)).decode()
        read(text)
        return text


def limits_of(
    lower: Sequence[float], upper: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float]
) -> JointLimits:
    """Limits of rows (n,), rad, rad/s, rad/s². Hard limits equal them, the effort is NaN: unknown."""
    low, high, fastest, change = (np.array(row) for row in (lower, upper, velocity, acceleration))
    return JointLimits(low, high, low, high, fastest, change, np.full(len(low), np.nan))


def entries(layout: ObservationLayout) -> Entries:
    """As a card has them."""
    places = {part.name: layout.places[part.name] for part in layout.parts}
    return {name: (place.start, place.stop - 1) for name, place in places.items()}


def read(text: str | bytes) -> PolicyCard:
    """The card of a JSON text. Raises InvalidInput saying what is wrong with it."""
    if len(text) > LARGEST:
        raise InvalidInput(f"its card has {len(text)} characters, at most {LARGEST} are read")
    try:
        given = strict_json.loads(text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text)
    except InvalidInput as error:
        raise InvalidInput(f"its card is no JSON: {error}") from None
    if not isinstance(given, dict) or given.get("format") != FORMAT:
        found = given.get("format") if isinstance(given, dict) else None
        raise InvalidInput(f"its format is {str(found)[:40]!r}, this twind reads {FORMAT!r}")
    unknown = sorted(set(given) - set(PolicyCard.__dataclass_fields__))
    if unknown:
        raise InvalidInput(f"its card has an unknown key {str(unknown[0])[:40]!r}")
    try:
        card = msgspec.convert(given, PolicyCard)
    except msgspec.ValidationError as error:
        raise InvalidInput(f"its card is not as {FORMAT} has it: {error}") from None
    _check(card)
    return card


def _check(card: PolicyCard) -> None:
    count = len(card.joints)
    if not 0 < count <= MOST_JOINTS or len(set(card.joints)) != count:
        raise InvalidInput(f"its card names {count} joints: 1 to {MOST_JOINTS}, each once, are needed")
    for name in ("default", "lower", "upper", "velocity", "acceleration"):
        row = np.array(getattr(card, name))
        if row.shape != (count,):
            raise InvalidInput(
                f"its card has {len(row)} numbers as {name}, one per joint ({count}) is needed"
            )
        if name in ("velocity", "acceleration") and not (row > 0.0).all():
            raise InvalidInput(f"its card: {name} of {card.joints[int(np.argmin(row))]} is not above 0")
    lower = np.array(card.lower)
    default = np.array(card.default)
    upper = np.array(card.upper)
    for at in np.flatnonzero(~((lower <= default) & (default <= upper))):
        reason = f"default {default[at]:g} rad of {card.joints[at]} is outside {lower[at]:g}..{upper[at]:g}"
        raise InvalidInput(f"its card: {reason}")
    slowest, fastest = RATES
    if not slowest - CLOSE <= card.rate_hz <= fastest + CLOSE:
        bounds = f"{slowest:g} to {fastest:g} are possible: a setpoint lapses after 0.1 s"
        raise InvalidInput(f"its card: {card.rate_hz:g} steps a second, {bounds}")
    places = list(card.layout.values())
    ends = [-1, *(last for _, last in places)]
    if any(first != end + 1 or last < first for (first, last), end in zip(places, ends, strict=False)):
        raise InvalidInput("its card: the ranges of the layout do not follow each other from 0")


@dataclass(frozen=True, slots=True)
class PolicyRobot:
    """Properties of a robot that a policy must fit. Rows are (n,) in the order of `joints`."""

    name: str
    joints: tuple[str, ...]
    layout: Entries
    lower: Sequence[float]  # rad, rad/s, rad/s²
    upper: Sequence[float]
    velocity: Sequence[float]
    acceleration: Sequence[float]
    rate_hz: float  # of the loop that drives it

    @classmethod
    def from_get_robot(cls, robot: Mapping[str, Any], rate_hz: float) -> "PolicyRobot":
        """Build it from the robot in an answer of `GetRobot`, for control at `rate_hz`."""
        joints = robot["joints"]
        names = tuple(joint["name"] for joint in joints)
        return cls(
            name=robot["name"],
            joints=names,
            layout=entries(ObservationLayout(names)),
            lower=[joint["lower"] for joint in joints],
            upper=[joint["upper"] for joint in joints],
            velocity=[joint["velocity_limit"] for joint in joints],
            acceleration=[joint["acceleration_limit"] for joint in joints],
            rate_hz=rate_hz,
        )

    @classmethod
    def from_limits(
        cls, name: str, layout: ObservationLayout, limits: JointLimits, rate_hz: float
    ) -> "PolicyRobot":
        """Build it from a robot in this process, for control at `rate_hz`."""
        rows = (limits.lower, limits.upper, limits.velocity, limits.acceleration)
        lower, upper, velocity, acceleration = (row.tolist() for row in rows)
        return cls(name, layout.joints, entries(layout), lower, upper, velocity, acceleration, rate_hz)

    @property
    def limits(self) -> JointLimits:
        """Limits of the robot."""
        return limits_of(self.lower, self.upper, self.velocity, self.acceleration)


def require_fit(card: PolicyCard, body: PolicyRobot) -> None:
    """Raises InvalidInput naming all that differs between what a policy was made for and a robot."""
    wrong = differences(card, body)
    if wrong:
        shown = "; ".join(wrong[:6]) + (f"; and {len(wrong) - 6} more" if len(wrong) > 6 else "")
        raise InvalidInput(f"made for {card.robot}, it does not fit {body.name}: {shown}")


def differences(card: PolicyCard, body: PolicyRobot) -> list[str]:
    """Return the reasons why the policy cannot drive this robot, a sentence each; empty: it fits."""
    if card.joints != body.joints:
        return _joints(card.joints, body.joints)  # without the same joints nothing else can be compared
    wrong = []
    mine = list(card.layout.items())
    yours = list(body.layout.items())
    if mine != yours:
        has, expected = _first_other(mine, yours)
        wrong.append(f"its observation has {has}, here that is {expected}")
    rows = [
        ("lower limit", card.lower, body.lower, -1.0),
        ("upper limit", card.upper, body.upper, 1.0),
        ("velocity", card.velocity, body.velocity, 1.0),
        ("acceleration", card.acceleration, body.acceleration, 1.0),
    ]
    for what, own, bound, sign in rows:
        wrong += [
            f"{joint}: its {what} {value:g} is beyond {may:g}"
            for joint, value, may in zip(card.joints, own, bound, strict=True)
            if not sign * value <= sign * may + CLOSE
        ]
    if not card.rate_hz <= body.rate_hz + CLOSE:
        wrong.append(f"it steps {card.rate_hz:g} times a second, the loop only {body.rate_hz:g}")
    return wrong


def _joints(mine: Sequence[str], yours: Sequence[str]) -> list[str]:
    missing = [name for name in mine if name not in yours]
    other = [name for name in yours if name not in mine]
    wrong = [f"the robot has no joint {', '.join(missing)}"] if missing else []
    wrong += [f"the policy knows no joint {', '.join(other)}"] if other else []
    if wrong:
        return wrong
    at = next(at for at, pair in enumerate(zip(mine, yours, strict=True)) if pair[0] != pair[1])
    return [f"joint {at} is its {mine[at]}, here {yours[at]}: the order differs"]


def _first_other(mine: Sequence[_Entry], yours: Sequence[_Entry]) -> tuple[str, str]:
    """The first part that differs, as both have it."""
    longest = max(len(mine), len(yours))
    padded = [[*row, *[None] * (longest - len(row))] for row in (mine, yours)]
    pair = next(pair for pair in zip(*padded, strict=True) if pair[0] != pair[1])
    has, expected = (f"{each[0]} at {each[1][0]}..{each[1][1]}" if each else "nothing" for each in pair)
    return has, expected
