"""Card of a policy from another framework: the YAML that says what its network receives and returns.

It stands beside the network as NAME.card.yaml, or in the `metadata_props` of the ONNX file (`twind_card`).
Figures are in the joint order and signs of the policy. Every error names file, line, key, value and remedy.
"""

from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.yaml_tree import parse, read_text
from twind.learn.cards.observation_terms import KNOWN
from twind.learn.policy.policy_card import RATES

FORMAT = "twind-card/1"
KEY = "twind_card"  # of the card in `metadata_props`
SUFFIX = ".card.yaml"
Pair = tuple[float, float]
Count = Annotated[int, Meta(ge=1, le=4096)]
Above = Annotated[float, Meta(gt=0.0)]
MOST_STATE = 1 << 20  # entries of a recurrent state


class TermSpec(ConfigStruct):
    """One term of an observation. Each entry becomes scale * clip(value + offset)."""

    term: Text | None = None  # None: the name of its key
    joints: tuple[Text, ...] | None = None  # None: those of the card
    entries: tuple[Annotated[int, Meta(ge=0, le=4095)], ...] | None = None  # of its values; None: all
    offset: float = 0.0
    clip: Pair | None = None
    scale: float = 1.0
    scales: tuple[float, ...] | None = None  # per entry
    reference: Literal["default", "zero"] = "default"  # that joint_position counts from
    age: Annotated[int, Meta(ge=1, le=3)] = 1  # of last_action
    size: Count = 1  # of constant
    value: float = 0.0  # of constant
    history: Count | None = None  # steps of this term; None: as its input


class InputSpec(ConfigStruct):
    """One observation input of the network."""

    terms: dict[str, TermSpec]
    history: Count = 1  # steps
    stacking: Literal["term", "step"] = "term"  # term: all steps of a term together
    newest: Literal["last", "first"] = "last"
    fill: Literal["first", "zero"] = "first"  # of the history before it is full
    shape: Literal["flat", "steps", "channels"] = "flat"  # (1, N); (1, steps, size); (1, size, steps)
    clip: Pair | None = None  # of every entry, at the end


class ActionSpec(ConfigStruct):
    """Meaning of the network's action: target = offset + scale * clip(action)."""

    output: Text
    scale_rad: float | None = None
    scales_rad: dict[str, float] | None = None  # by joint; others have scale_rad
    offset: Literal["default", "zero"] = "default"
    clip: Pair | None = None
    # To a target: at constant speed through a period, or at once. At once lags where acceleration is limited:
    # knees of h24 that swing 0.2 rad at 1 Hz were off by 26 mrad rms at once, by 5 mrad at constant speed.
    path: Literal["linear", "hold"] = "linear"


class StateSpec(ConfigStruct):
    """One recurrent state: fed back from an output, zero at the start."""

    output: Text
    shape: tuple[Count, ...]


class PhaseSpec(ConfigStruct):
    """Clock of a gait: one phase per offset."""

    period_s: Above
    offsets_rad: tuple[float, ...] = (0.0,)
    still_rad: float | None = None  # every phase while the command is zero; None: they go on


class CommandSpec(ConfigStruct):
    """Command ranges of the training."""

    forward: Pair = (0.0, 0.0)  # m/s
    left: Pair = (0.0, 0.0)  # m/s
    turn: Pair = (0.0, 0.0)  # rad/s


class VectorSpec(ConfigStruct):
    """Test vectors: an .npz file beside the card with an array (k, ...) for each input and output."""

    file: Text
    tolerance: Above = 1e-4


class InterfaceCard(ConfigStruct):
    """A whole card, checked in itself; nothing of a robot is known yet."""

    format: Text
    joints: tuple[Text, ...]  # of the actions, in the policy's order, by the names of the robot file
    rate_hz: Annotated[float, Meta(ge=RATES[0], le=RATES[1])]
    default_rad: dict[str, float]  # joint: position
    inputs: dict[str, InputSpec]
    action: ActionSpec
    name: Text | None = None
    robot: Text | None = None
    decimation: Count | None = None  # physics steps of a control step in the training: not used
    signs: dict[str, Literal[-1, 1]] = msgspec.field(default_factory=dict)
    state: dict[str, StateSpec] = msgspec.field(default_factory=dict)
    phase: PhaseSpec | None = None
    command: CommandSpec = msgspec.field(default_factory=CommandSpec)
    test: VectorSpec | None = None

    @property
    def period(self) -> float:
        """Time between two actions, s."""
        return 1.0 / self.rate_hz

    @property
    def ranges(self) -> Mapping[str, Pair]:
        """Command ranges by axis."""
        return {axis: getattr(self.command, axis) for axis in ("forward", "left", "turn")}

    @property
    def named_joints(self) -> tuple[str, ...]:
        """Every joint that the card names, once."""
        terms = [term for each in self.inputs.values() for term in each.terms.values()]
        return tuple(dict.fromkeys((*self.joints, *(name for term in terms for name in term.joints or ()))))

    def scale(self, joint: str) -> float:
        """Rad per unit of the action of a joint."""
        common = self.action.scale_rad or 0.0
        return (self.action.scales_rad or {}).get(joint, common)


def card_beside(network: Path) -> Path:
    """Return where the card of a network stands."""
    return network.with_name(network.name.removesuffix(".onnx") + SUFFIX)


def read_card(path: Path) -> tuple[InterfaceCard, str]:
    """Return the card of a file and its text. Raises ConfigError."""
    text = read_text(path)
    return parse_card(text, str(path)), text


def parse_card(text: str, file: str) -> InterfaceCard:
    """Return the card that a text holds. Raises ConfigError naming `file`."""
    reader = ConfigReader(file, parse(text, file))
    reader.require_format(FORMAT)
    card = reader.read(InterfaceCard)
    _check_joints(reader, card)
    _check_action(reader.section("action"), card)
    _check_state(reader, card)
    if not card.inputs:
        raise reader.refuse("inputs", "none is described: name each input of the network with its terms")
    for name, given in card.inputs.items():
        _check_input(reader.section("inputs").section(name), given, card)
    for axis, (low, high) in card.ranges.items():
        if not low <= high:
            raise reader.section("command").refuse(axis, f"[{low:g}, {high:g}]: the lower end comes first")
    return card


def _check_joints(reader: ConfigReader, card: InterfaceCard) -> None:
    if not card.joints or len(set(card.joints)) != len(card.joints):
        raise reader.refuse("joints", "name each joint of the action once, in the order of the network")
    missing = [name for name in card.named_joints if name not in card.default_rad]
    if missing:
        raise reader.refuse("default_rad", f"has no position of {', '.join(missing[:4])}")
    for name in card.signs:
        if name not in card.named_joints:
            raise reader.section("signs").refuse(name, f"no term and no action has a joint {name!r}")


def _check_action(reader: ConfigReader, card: InterfaceCard) -> None:
    given = card.action
    for name in given.scales_rad or {}:
        if name not in card.joints:
            raise reader.section("scales_rad").refuse(name, f"no action has a joint {name!r}")
    for name in card.joints:
        if not card.scale(name):
            raise reader.refuse("scale_rad", f"the action of {name} has no scale: give scale_rad, or its own")
    _check_pair(reader, "clip", given.clip)


def _check_state(reader: ConfigReader, card: InterfaceCard) -> None:
    outputs = [card.action.output, *(each.output for each in card.state.values())]
    for name, given in card.state.items():
        section = reader.section("state").section(name)
        if name in card.inputs:
            raise reader.section("state").refuse(name, "is an observation input too: keep one of them")
        if outputs.count(given.output) > 1:
            raise section.refuse("output", f"{given.output!r} is named twice")
        if prod(given.shape) > MOST_STATE:
            raise section.refuse("shape", f"has more than {MOST_STATE} entries")


def _check_input(reader: ConfigReader, given: InputSpec, card: InterfaceCard) -> None:
    _check_pair(reader, "clip", given.clip)
    if not given.terms:
        raise reader.refuse("terms", "an observation needs a term")
    if given.shape != "flat" and given.stacking != "step":
        raise reader.refuse("shape", f"{given.shape} has a row per step: write stacking: step")
    terms = reader.section("terms")
    for name, term in given.terms.items():
        section = terms.section(name)
        kind = KNOWN.get(term.term or name)
        if kind is None:
            raise terms.refuse(name, f"no term {term.term or name!r}; known: {', '.join(KNOWN)}")
        if (term.term or name).startswith("phase_") and card.phase is None:
            raise terms.refuse(name, "needs a section phase: {period_s: ..., offsets_rad: [...]}")
        if term.joints is not None and kind.each != "joint":
            raise section.refuse("joints", "this term is not of joints")
        if (term.history or 1) > given.history or (term.history and given.stacking == "step"):
            raise section.refuse("history", "a term's own history is at most its input's, stacking: term")
        _check_pair(section, "clip", term.clip)


def _check_pair(reader: ConfigReader, key: str, pair: Pair | None) -> None:
    if pair is not None and not pair[0] < pair[1]:
        raise reader.refuse(key, f"[{pair[0]:g}, {pair[1]:g}]: the lower bound comes first")
