"""A carded policy on a robot: targets from actions, recurrent state, and networks that do not fit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import COUNTER, HEAD, PLAIN, carded, convolution, counter, linear, lstm
from tests.support.policy_world import POSE, World
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardActor, CardPolicy
from twind.learn.cards.card_file import load_any
from twind.learn.cards.interface_card import parse_card
from twind.learn.policy.onnx_session import OnnxSession
from twind.learn.policy.policy_card import limits_of
from twind.learn.policy.policy_controller import NoSetpoint, PolicyController, PolicySetpoint
from twind.learn.task.observation import BodyReading
from twind.robot_client.state_message import STALE
from twind.safety.setpoint_gate import judge

ROBOT = ("hip", "knee")
LIMITS = limits_of((-1.0, -1.0), (1.0, 1.0), (4.0, 4.0), (20.0, 20.0))


def policy(folder: Path, network: Any, card: str) -> CardPolicy:
    made = load_any(carded(folder, network, card))
    assert isinstance(made, CardPolicy)
    return made


def untried(card: str) -> CardPolicy:
    """A policy without the check in a process of its own, which takes half a second."""
    return CardPolicy(parse_card(card, "x"), OnnxSession(linear(5, 2).SerializeToString()))


def actor(folder: Path, network: Any, card: str) -> CardActor:
    return CardActor(policy(folder, network, card), ROBOT, LIMITS, np.zeros(2))


def acted(made: CardActor, step: int = 0) -> Any:
    reading = BodyReading.empty(len(made.joints))
    reading.gravity[...] = (0.0, 0.0, -1.0)
    action = made.act(reading, np.zeros(3), step)
    assert not isinstance(action, str), action
    return action


def test_targets_are_offset_and_scale_in_the_order_and_signs_of_the_card(tmp_path: Path) -> None:
    text = (
        HEAD
        + "signs: {knee: -1}\n"
        + PLAIN.replace("scale_rad: 0.5", "scale_rad: 0.5, scales_rad: {hip: 0.1}")
    )
    made = actor(tmp_path, linear(5, 2, bias=[1.0, 2.0]), text)
    np.testing.assert_allclose(made.shaper.default, [0.1, -0.2])
    target, velocity = made.shape(acted(made))
    np.testing.assert_allclose(target, [0.1 + 0.1 * 2.0, -(0.2 + 0.5 * 1.0)])
    assert not velocity.any()


def test_an_action_may_count_from_zero(tmp_path: Path) -> None:
    made = actor(tmp_path, linear(5, 2, bias=[1.0, 0.5]), HEAD + PLAIN.replace("0.5,", "0.5, offset: zero,"))
    np.testing.assert_allclose(made.shape(acted(made))[0], [0.25, 0.5])


def test_a_target_beyond_the_limits_is_cut_and_counted(tmp_path: Path) -> None:
    made = actor(tmp_path, linear(5, 2, bias=[9.0, 0.0]), HEAD + PLAIN)
    np.testing.assert_allclose(made.shape(acted(made))[0], [0.1, 1.0], atol=1e-5)
    assert made.shaper.clipped == 1


@pytest.mark.parametrize(("clip", "reached"), [("[-9.0, -8.0]", -1.0), ("[8.0, 9.0]", 1.0)])
def test_actions_that_all_lie_beyond_the_limits_hold_the_limit(
    tmp_path: Path, clip: str, reached: float
) -> None:
    text = HEAD + PLAIN.replace("scale_rad: 0.5", f"scale_rad: 0.5, clip: {clip}")
    made = actor(tmp_path, linear(5, 2), text)
    made.begin()
    assert (np.abs(made.shaper.target) <= 1.0).all()
    target, _ = made.shape(acted(made))
    np.testing.assert_allclose(target, [reached, reached], atol=1e-5)


def test_an_action_is_clipped_before_it_is_scaled(tmp_path: Path) -> None:
    made = actor(tmp_path, linear(5, 2, bias=9.0), HEAD + PLAIN.replace("0.5,", "0.5, clip: [-1.0, 0.2],"))
    assert acted(made).tolist() == pytest.approx([0.2, 0.2])


def test_a_linear_path_reaches_its_target_at_the_end_of_the_period(tmp_path: Path) -> None:
    made = actor(tmp_path, linear(5, 2, bias=0.1), HEAD + PLAIN.replace("hold", "linear"))
    target, velocity = made.shape(acted(made))
    np.testing.assert_allclose(target, [0.15, 0.25])
    np.testing.assert_allclose(target - velocity * 0.02, [0.1, 0.2])


@settings(max_examples=100, deadline=None)
@given(
    actions=st.lists(st.tuples(*[st.floats(-5.0, 5.0, width=32)] * 2), min_size=1, max_size=12),
    path=st.sampled_from(["hold", "linear"]),
    hip=st.sampled_from([-1.0, 0.1, 1.0]),
)
def test_no_action_makes_a_setpoint_that_the_gate_refuses(
    actions: list[tuple[float, ...]], path: str, hip: float
) -> None:
    text = (HEAD + PLAIN.replace("hold", path)).replace("hip: 0.1", f"hip: {hip}")
    made = CardActor(untried(text), ROBOT, LIMITS, np.zeros(2))
    for action in actions:
        target, velocity = made.shape(np.float32(action))
        sent = target - velocity * made.period
        found = judge(np.arange(2), sent, velocity, LIMITS, valid_for=0.06, allow_clamp=False)
        assert not found.verdict.refusals, found.verdict


def test_joints_that_the_card_does_not_name_keep_the_pose_of_the_robot(tmp_path: Path) -> None:
    made = CardActor(
        policy(tmp_path, linear(5, 2, bias=0.1), HEAD + PLAIN),
        ("head", *ROBOT),
        limits_of(*[(bound,) * 3 for bound in (-1.0, 1.0, 4.0, 20.0)]),
        np.array([0.7, 0.0, 0.0]),
    )
    assert made.shape(acted(made))[0][0] == 0.7


def test_the_recurrent_state_goes_on_and_is_zero_again_at_a_new_start(tmp_path: Path) -> None:
    made = actor(tmp_path, counter(), HEAD + COUNTER)
    assert [acted(made)[0] for _ in range(3)] == [1.0, 2.0, 3.0]
    made.begin()
    assert acted(made)[0] == 1.0


def test_a_hold_resets_the_recurrent_state(tmp_path: Path) -> None:
    """A reading that is too old makes the robot hold; an e-stop ends the drive, and the next begins anew."""
    world = World()
    made = actor(tmp_path, counter(), HEAD + COUNTER)
    world.controller = PolicyController(made, world, lambda reading: False, np.zeros(3), lambda: world.now)
    world.goal = made.shaper.default.copy()
    for _ in range(4):
        assert isinstance(world.step(), PolicySetpoint)
    assert world.sent[-1].position - made.shaper.default == pytest.approx([0.004, 0.004])
    assert isinstance(world.step(STALE + 0.01), NoSetpoint)
    done = [world.step() for _ in range(2)]
    assert isinstance(done[-1], PolicySetpoint)
    assert done[-1].position - made.shaper.default == pytest.approx([0.001, 0.001])
    assert POSE.shape == (2,)


def test_an_lstm_and_a_convolution_over_history_run(tmp_path: Path) -> None:
    state = "{h_in: {output: h_out, shape: [1, 1, 16]}, c_in: {output: c_out, shape: [1, 1, 16]}}"
    recurrent = actor(tmp_path, lstm(5, 2), f"{HEAD}state: {state}\n{PLAIN}")
    first = acted(recurrent)
    assert np.abs(first - acted(recurrent)).max() > 1e-4  # the same reading, another state
    text = HEAD + PLAIN.replace("obs: {", "obs: {history: 4, stacking: step, shape: channels, ")
    assert np.isfinite(acted(actor(tmp_path, convolution(5, 4, 2), text))).all()


def test_a_network_without_a_batch_is_run(tmp_path: Path) -> None:
    from onnx import helper

    from tests.support.card_files import model

    node = helper.make_node("Gather", ["obs", "first"], ["actions"])
    network = model([node], {"first": [0, 1]}, {"obs": [5]}, {"actions": [2]})
    network.graph.initializer[0].CopyFrom(helper.make_tensor("first", 7, [2], [0, 1]))
    np.testing.assert_allclose(acted(actor(tmp_path, network, HEAD + PLAIN)), [-0.2, -0.1])


@pytest.mark.parametrize(
    ("network", "card", "message"),
    [
        (linear(6, 2), PLAIN, r"input obs has the shape \['batch', 6\], by its card \[1, 5\]"),
        (linear(5, 3), PLAIN, r"output actions has the shape \['batch', 3\], by its card \[1, 2\]"),
        (
            linear(5, 2),
            PLAIN.replace("actions", "a"),
            "the network has the outputs actions; its card names a",
        ),
        (counter(), PLAIN, "the network has the inputs obs, s_in; its card names obs"),
        (
            counter(),
            COUNTER.replace("[1, 2]", "[1, 3]"),
            r"input s_in has the shape \[1, 2\], by its card \[1, 3\]",
        ),
    ],
)
def test_a_network_that_does_not_fit_its_card_is_refused_by_name_and_shape(
    tmp_path: Path, network: Any, card: str, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        policy(tmp_path, network, HEAD + card)


@pytest.mark.parametrize(
    ("robot", "limits", "message"),
    [
        (("hip", "ankle"), LIMITS, "its card names knee, the robot has hip, ankle"),
        (
            ROBOT,
            replace(LIMITS, upper=np.array([0.0, 1.0])),
            "default of hip is 0.1 rad, the robot allows -1..0",
        ),
    ],
)
def test_a_robot_that_does_not_fit_the_card_is_named(
    tmp_path: Path, robot: tuple[str, ...], limits: Any, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        CardActor(policy(tmp_path, linear(5, 2), HEAD + PLAIN), robot, limits, np.zeros(2))


def test_entries_and_scales_that_a_term_does_not_have_are_refused(tmp_path: Path) -> None:
    for more, message in (
        ("entries: [3]", "has 3 entries, 3 is none"),
        ("scales: [1.0]", "3 entries and 1 scales"),
    ):
        with pytest.raises(InvalidInput, match=message):
            policy(tmp_path, linear(5, 2), HEAD + PLAIN.replace("gravity: {}", f"gravity: {{{more}}}"))
