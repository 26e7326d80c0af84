"""Cards: what they say, and that every mistake is named with its line and a remedy."""

import math

import pytest

from tests.support.card_files import COUNTER, HEAD, PLAIN
from twind.config.yaml_tree import ConfigError
from twind.learn.cards.interface_card import parse_card
from twind.learn.cards.observation_terms import KNOWN


def test_a_card_keeps_the_order_of_its_terms_and_joints() -> None:
    card = parse_card(HEAD + PLAIN, "x.yaml")
    assert card.joints == ("knee", "hip") and list(card.inputs["obs"].terms) == [
        "joint_position",
        "projected_gravity",
    ]
    assert card.period == pytest.approx(0.02) and card.scale("hip") == 0.5


def test_angles_may_be_degrees() -> None:
    text = (HEAD + PLAIN).replace("default_rad: {hip: 0.1, knee: 0.2}", "default_deg: {hip: 90.0, knee: 0.0}")
    assert parse_card(text, "x").default_rad["hip"] == pytest.approx(math.pi / 2)


def test_a_scale_of_its_own_precedes_the_common_one() -> None:
    text = HEAD + PLAIN.replace("scale_rad: 0.5", "scale_rad: 0.5, scales_rad: {hip: 0.25}")
    card = parse_card(text, "x")
    assert (card.scale("hip"), card.scale("knee")) == (0.25, 0.5)


def test_an_unknown_term_is_refused_by_name_with_the_known_ones() -> None:
    text = HEAD + PLAIN.replace("projected_gravity", "gravity_vector")
    with pytest.raises(ConfigError, match=r"x\.yaml:5:.*no term 'gravity_vector'; known: ") as refused:
        parse_card(text, "x.yaml")
    assert all(name in str(refused.value) for name in KNOWN)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("twind-card/1", "twind-card/9", "'twind-card/9' is not twind-card/1"),
        ("rate_hz: 50.0", "rate_hz: 5.0", "x.yaml:2:10: rate_hz: 5 is outside"),
        ("[knee, hip]", "[knee, knee]", "joints: name each joint of the action once"),
        ("knee: 0.2", "ankle: 0.2", "default_rad: has no position of knee"),
        ("default_rad", "default_pose", "unknown key"),
        ("scale_rad: 0.5", "scale_rad: 0.5, scales_rad: {elbow: 1.0}", "no action has a joint 'elbow'"),
        (", scale_rad: 0.5", "", "the action of knee has no scale"),
        ("projected_gravity: {}", "phase_sin: {}", "needs a section phase"),
        ("projected_gravity: {}", "projected_gravity: {joints: [hip]}", "this term is not of joints"),
        ("projected_gravity: {}", "projected_gravity: {clip: [1.0, -1.0]}", "the lower bound comes first"),
        ("projected_gravity: {}", "projected_gravity: {history: 2}", "a term's own history is at most"),
        ("obs: {", "obs: {shape: channels, ", "write stacking: step"),
        ("{joint_position: {}, projected_gravity: {}}", "{}", "an observation needs a term"),
        ("inputs:", "command: {left: [1.0, -1.0]}\ninputs:", "command.left: .* the lower end comes first"),
        ("inputs:", "signs: {elbow: -1}\ninputs:", "no term and no action has a joint 'elbow'"),
        ("inputs:", "signs: {hip: 2}\ninputs:", "signs.hip: 2 is none of"),
    ],
)
def test_a_mistake_is_named(old: str, new: str, message: str) -> None:
    assert old in HEAD + PLAIN
    with pytest.raises(ConfigError, match=message):
        parse_card((HEAD + PLAIN).replace(old, new, 1), "x.yaml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("s_in:", "obs:", "is an observation input too"),
        ("output: s_out", "output: actions", "'actions' is named twice"),
        ("[1, 2]}", "[4096, 4096]}", "has more than"),
    ],
)
def test_a_recurrent_state_is_its_own_pair(old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_card(HEAD + COUNTER.replace(old, new, 1), "x")
