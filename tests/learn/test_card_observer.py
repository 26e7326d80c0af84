"""The observation of a carded policy: each entry in its place, scaled, signed and stacked."""

from math import pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twind.learn.cards.card_observer import CardObserver
from twind.learn.cards.interface_card import parse_card
from twind.learn.task.observation import BodyReading

ROBOT = ("hip", "knee", "ankle")
POSE = np.array([0.1, 0.2, 0.3])
TARGET = np.array([0.5, 0.6, 0.7])
COMMAND = np.array([0.4, -0.1, 0.2])


def observer(terms: str, more: str = "", head: str = "") -> CardObserver:
    text = (
        "format: twind-card/1\nrate_hz: 50.0\njoints: [knee, hip]\ndefault_rad: {hip: 0.1, knee: 0.2}\n"
        f"{head}\ninputs: {{obs: {{{more} terms: {{{terms}}}}}}}\naction: {{output: a, scale_rad: 1.0}}\n"
    )
    return CardObserver(parse_card(text, "x"), ROBOT, POSE)


def reading(**rows: Any) -> BodyReading:
    made = BodyReading.empty(3)
    made.gravity[...] = (0.0, 0.0, -1.0)
    for name, values in rows.items():
        getattr(made, name)[...] = values
    return made


def seen(watch: CardObserver, now: BodyReading, step: int = 0, command: Any = COMMAND) -> np.ndarray:
    found = watch.observe(now, TARGET, command, step)
    assert isinstance(found, dict), found
    return found["obs"][0]


def test_joints_are_in_the_order_and_signs_of_the_card() -> None:
    watch = observer("joint_position: {}, joint_velocity: {scale: 0.5}", head="signs: {hip: -1}")
    now = reading(position=POSE + np.array([0.01, 0.02, 0.03]), velocity=(1.0, 2.0, 3.0))
    np.testing.assert_allclose(seen(watch, now), [0.02, -0.01, 1.0, -0.5], atol=1e-7)


def test_a_term_may_name_joints_of_its_own_and_count_from_zero() -> None:
    text = "format: twind-card/1\nrate_hz: 50.0\njoints: [knee]\nsigns: {hip: -1}\n"
    text += "default_rad: {hip: -0.1, knee: 0.2, ankle: 0.3}\naction: {output: a, scale_rad: 1.0}\n"
    text += (
        "inputs: {obs: {terms: {joint_position: {joints: [ankle, hip], reference: zero}, joint_target: {}}}}"
    )
    watch = CardObserver(parse_card(text, "x"), ROBOT, POSE)
    now = reading(position=(0.4, 0.5, 0.6))
    np.testing.assert_allclose(seen(watch, now), [0.6, -0.4, 0.6], atol=1e-6)


def test_an_entry_is_offset_then_clipped_then_scaled() -> None:
    watch = observer("base_angular_velocity: {offset: 1.0, clip: [-2.0, 2.0], scale: 0.5}")
    np.testing.assert_allclose(seen(watch, reading(gyro=(0.0, 3.0, -9.0))), [0.5, 1.0, -1.0])


def test_scales_and_entries_are_per_value() -> None:
    watch = observer("velocity_command: {scales: [2.0, 0.25], entries: [0, 2]}")
    np.testing.assert_allclose(seen(watch, reading()), [0.8, 0.05])


def test_a_constant_fills_in_for_what_a_robot_does_not_have() -> None:
    assert seen(observer("scan: {term: constant, size: 4, value: -0.5}"), reading()).tolist() == [-0.5] * 4


def test_last_actions_are_those_that_were_sent_by_age() -> None:
    watch = observer("last_action: {}, before: {term: last_action, age: 3}")
    for number in range(1, 4):
        watch.record(np.array([number, 10.0 * number]))
    assert seen(watch, reading()).tolist() == [3.0, 30.0, 1.0, 10.0]
    watch.begin()
    assert seen(watch, reading()).tolist() == [0.0] * 4


def test_phases_advance_with_the_steps_and_rest_at_no_command() -> None:
    head = "phase: {period_s: 0.4, offsets_rad: [0.0, 3.14159265358979], still_rad: 3.14159265358979}"
    watch = observer("phase_cos: {}, phase_sin: {}", head=head)
    np.testing.assert_allclose(seen(watch, reading(), 5), [0.0, 0.0, 1.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(seen(watch, reading(), 5, np.zeros(3)), [-1.0, -1.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.4, 0.0), (0.0, -0.3), (0.2, 0.5)])
def test_the_attitude_is_that_of_gravity(roll: float, pitch: float) -> None:
    down = (np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch))
    found = seen(observer("orientation: {}, roll_pitch_yaw: {}"), reading(gravity=down))
    np.testing.assert_allclose(found[4:], [roll, pitch, 0.0], atol=1e-6)
    w, x, y, z = found[:4].astype(float)
    turned = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]  # of the world's z axis
    np.testing.assert_allclose(turned, -np.array(down), atol=1e-6)


def test_yaw_is_integrated_from_the_gyro() -> None:
    watch = observer("roll_pitch_yaw: {}")
    for _ in range(51):
        found = seen(watch, reading(gyro=(0.0, 0.0, 0.5)))
    assert found[2] == pytest.approx(0.5, abs=1e-6)


def test_the_lower_foot_counts_as_standing() -> None:
    watch = observer("foot_contact: {}")
    assert seen(watch, reading(soles=[[0, 0.1, -0.5], [0, -0.1, -0.45]])).tolist() == [1.0, 0.0]
    assert seen(watch, reading(soles=[[0, 0.1, -0.5], [0, -0.1, -0.495]])).tolist() == [1.0, 1.0]


def test_a_value_that_is_not_finite_is_named() -> None:
    watch = observer("projected_gravity: {}, joint_velocity: {}")
    assert watch.observe(reading(velocity=(np.nan, 0.0, 0.0)), TARGET, COMMAND, 0) == (
        "entry joint_velocity[1] of the observation is not finite"
    )


def test_a_value_that_float32_cannot_hold_is_named() -> None:
    watch = observer("joint_velocity: {scale: 1.0e+38}")
    assert watch.observe(reading(velocity=(0.0, 100.0, 0.0)), TARGET, COMMAND, 0) == (
        "entry joint_velocity[0] of the observation is not finite"
    )


@given(
    st.integers(1, 4),
    st.integers(0, 6),
    st.sampled_from(["term", "step"]),
    st.sampled_from(["last", "first"]),
    st.sampled_from(["first", "zero"]),
)
@settings(max_examples=60, deadline=None)
def test_history_is_stacked_as_the_card_says(
    steps: int, extra: int, stacking: str, newest: str, fill: str
) -> None:
    more = f"history: {steps}, stacking: {stacking}, newest: {newest}, fill: {fill},"
    watch = observer("base_angular_velocity: {}, base_height: {}", more)
    rows = [np.array([k, k + 0.25, k + 0.5, 2.0 + 0.1 * k]) for k in range(extra + 1)]
    for row in rows:
        found = seen(watch, reading(gyro=row[:3], height=row[3]))
    before = np.zeros(4) if fill == "zero" else rows[0]
    kept = ([before] * steps + rows)[-steps:]
    kept = kept if newest == "last" else kept[::-1]
    parts = [np.concatenate(kept)]
    if stacking == "term":
        parts = [np.concatenate([row[:3] for row in kept]), np.array([row[3] for row in kept])]
    np.testing.assert_allclose(found, np.concatenate(parts), atol=1e-5)


def test_a_term_may_have_a_shorter_history() -> None:
    watch = observer("base_angular_velocity: {history: 1}, base_height: {}", "history: 3,")
    for k in range(5):
        found = seen(watch, reading(gyro=(k, k, k), height=k))
    assert found.tolist() == [4.0, 4.0, 4.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(("shape", "expected"), [("steps", (1, 3, 4)), ("channels", (1, 4, 3))])
def test_a_network_over_time_gets_rows_or_channels(shape: str, expected: tuple[int, ...]) -> None:
    more = f"history: 3, stacking: step, shape: {shape},"
    watch = observer("base_angular_velocity: {}, base_height: {}", more)
    for k in range(3):
        found = watch.observe(reading(gyro=(k, k, k), height=0.1 * k), TARGET, COMMAND, k)
    assert isinstance(found, dict) and found["obs"].shape == expected
    rows = found["obs"][0] if shape == "steps" else found["obs"][0].T
    np.testing.assert_allclose(rows[:, 3], [0.0, 0.1, 0.2], atol=1e-6)


def test_yaw_stays_within_half_a_turn() -> None:
    watch = observer("roll_pitch_yaw: {}")
    for _ in range(200):
        found = seen(watch, reading(gyro=(0.0, 0.0, 3.0)))
    assert abs(found[2]) <= pi
