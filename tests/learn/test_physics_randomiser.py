"""twind.learn.randomise: a draw, and what each of its quantities does to the physics, and to nothing else."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS, Batch

from tests.support.learn_rig import body, places
from twind.learn.randomise.episode_start import DelayHistories, EpisodeStart
from twind.learn.randomise.physics_randomiser import (
    CHANGES,
    BatchModelWriter,
    PhysicsRandomiser,
    SingleModelWriter,
    in_steps,
)
from twind.learn.randomise.randomisation_ranges import (
    DrawSampler,
    EpisodeDraw,
    RandomisationRanges,
    load_ranges,
)

JOINTS = 24
LINKS = 25
KNEE = "l_knee"
POINTS = {
    "friction": 0.5,
    "mass": 1.1,
    "centre_of_mass": 0.02,
    "armature": 1.5,
    "damping": 2.0,
    "frictionloss": 2.0,
    "stiffness": 1.2,
    "braking": 1.3,
    "encoder_zero": 0.1,
    "action_delay": 0.015,
    "imu_delay": 0.01,
}

ONE_MOTOR = """<mujoco><option timestep="0.005"/>
<worldbody><body><joint name="a" type="slide"/><geom size=".1"/></body></worldbody>
<actuator><motor joint="a" nsample="8"/></actuator></mujoco>"""


def only(quantity: str, value: float | None = None) -> RandomisationRanges:
    """Nothing but this, always the same."""
    value = POINTS[quantity] if value is None else value
    return replace(RandomisationRanges(), **{quantity: (value, value)})


def drawn(ranges: RandomisationRanges, seed: int = 0) -> EpisodeDraw:
    return DrawSampler(ranges, JOINTS, LINKS).draw(np.random.default_rng(seed))


def changed(ranges: RandomisationRanges) -> tuple[Any, Any]:
    """The body as it is, and as a draw makes it."""
    model = body()
    SingleModelWriter(PhysicsRandomiser(ranges, model, places(model)), model).apply(drawn(ranges))
    return body(), model


def forward(model: Any, **state: Any) -> Any:
    data = mujoco.MjData(model)
    for name, value in state.items():
        getattr(data, name)[:] = value
    mujoco.mj_forward(model, data)
    return data


def differing(one: Any, other: Any) -> set[str]:
    names = [name for name in MODEL_FIELDS if not name.startswith("opt.")]
    return {name for name in names if not np.array_equal(getattr(one, name), getattr(other, name))}


# ------------------------------------------------------------------------------------------ draws


def test_a_draw_is_a_function_of_the_generators_state() -> None:
    ranges = load_ranges("default")
    one, same, other = (drawn(ranges, seed) for seed in (3, 3, 4))
    for name in EpisodeDraw._fields:
        assert np.array_equal(getattr(one, name), getattr(same, name))
        assert not np.array_equal(getattr(one, name), getattr(other, name))


def test_every_drawn_value_is_in_its_range_and_reaches_both_ends() -> None:
    ranges = load_ranges("default")
    rng = np.random.default_rng(0)
    draws = DrawSampler(ranges, JOINTS, LINKS)
    many = [draws.draw(rng) for _ in range(300)]
    for name in EpisodeDraw._fields:
        low, high = getattr(ranges, name)
        found = np.array([getattr(draw, name) for draw in many])
        assert low <= found.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < found.max() <= high


def test_each_joint_and_link_is_drawn_by_itself() -> None:
    draw = drawn(load_ranges("default"))
    assert np.unique(draw.mass).size == LINKS
    assert np.unique(draw.encoder_zero).size == JOINTS


def test_the_profile_none_draws_nothing_and_writes_nothing() -> None:
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    draw = DrawSampler(RandomisationRanges(), JOINTS, LINKS).draw(rng)
    assert rng.bit_generator.state == before
    model = body()
    physics = PhysicsRandomiser(RandomisationRanges(), model, places(model))
    SingleModelWriter(physics, model).apply(draw)
    assert physics.fields == () and differing(model, body()) == set()


def test_the_rest_of_the_draws_are_the_same_whichever_range_is_a_point() -> None:
    ranges = load_ranges("default")
    one = drawn(ranges)
    other = drawn(replace(ranges, friction=(1.0, 1.0)))
    assert np.array_equal(one.encoder_zero, other.encoder_zero)


# ------------------------------------------------------------------------- each quantity, and only it


@pytest.mark.parametrize("quantity", POINTS)
def test_a_quantity_writes_its_fields_and_no_other(quantity: str) -> None:
    model = body()
    physics = PhysicsRandomiser(only(quantity), model, places(model))
    physics.write(drawn(only(quantity)), {name: getattr(model, name) for name in physics.fields})
    expected = next(set(each.fields) for each in CHANGES if each.quantity == quantity)
    assert differing(model, body()) == expected == set(physics.fields)


def test_friction_is_that_of_the_contacts() -> None:
    was, now = (forward(model, qpos=standing(model)) for model in changed(only("friction")))
    assert was.ncon == now.ncon > 0
    assert np.array_equal(now.contact.friction[:, 0], 0.5 * was.contact.friction[:, 0])


def standing(model: Any) -> Any:
    """Sunk into the floor a little."""
    qpos = model.qpos0.copy()
    qpos[2] -= 0.105
    return qpos


def test_mass_is_what_the_floor_carries_and_what_turns() -> None:
    was, now = changed(only("mass"))
    assert now.body_subtreemass[1] == pytest.approx(1.1 * was.body_subtreemass[1])
    of = [inertia(model) - np.diag(model.dof_armature) for model in (was, now)]
    assert of[1] == pytest.approx(1.1 * of[0], rel=1e-9, abs=1e-12)


def inertia(model: Any) -> Any:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, forward(model), full)
    return full


def test_the_centre_of_mass_of_the_base_is_where_it_was_drawn() -> None:
    was, now = (forward(model) for model in changed(only("centre_of_mass")))
    assert now.xipos[1] - was.xipos[1] == pytest.approx([0.02] * 3)
    assert np.array_equal(now.xipos[2:], was.xipos[2:])


def test_armature_is_on_the_diagonal_of_the_mass_matrix() -> None:
    was, now = changed(only("armature"))
    more = inertia(now) - inertia(was)
    assert np.diag(more)[6:] == pytest.approx(0.5 * was.dof_armature[6:])
    assert np.abs(more - np.diag(np.diag(more))).max() < 1e-12
    assert np.abs(np.diag(more)[:6]).max() < 1e-12


@pytest.mark.parametrize(
    ("quantity", "state", "force", "factor"),
    [
        ("damping", {"qvel": 1.0}, "qfrc_passive", 2.0),
        ("stiffness", {"ctrl": 0.02}, "actuator_force", 1.2),
        ("braking", {"qvel": 0.5}, "actuator_force", 1.3),
    ],
)
def test_a_gain_scales_its_torque(quantity: str, state: dict[str, float], force: str, factor: float) -> None:
    was, now = (getattr(forward(model, **state), force)[-JOINTS:] for model in changed(only(quantity)))
    assert now == pytest.approx(factor * was)


def test_frictionloss_is_how_much_a_joint_holds_by_itself() -> None:
    was, now = (forward(model, qvel=5.0, ctrl=0.0) for model in changed(only("frictionloss")))
    rows = [
        data.efc_frictionloss[data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF]
        for data in (was, now)
    ]
    assert rows[1] == pytest.approx(2.0 * rows[0])


def test_an_encoder_offset_changes_the_reported_angle_and_not_the_body() -> None:
    was, now = changed(only("encoder_zero"))
    told = was.qpos0.copy()
    told[7:] += 0.1
    assert np.array_equal(now.qpos0, told)
    one = forward(was, qpos=was.qpos0)
    other = forward(now, qpos=told)
    assert np.allclose(one.xpos, other.xpos, atol=1e-12)
    assert not np.allclose(one.xpos, forward(now, qpos=was.qpos0).xpos, atol=1e-3)
    assert now.joint(KNEE).range == pytest.approx(was.joint(KNEE).range + 0.1)


# --------------------------------------------------------------------------------------------- delays


def reacts(model: Any, steps: int) -> list[bool]:
    """In which of the next steps the actuators do anything, after a new control."""
    data = mujoco.MjData(model)
    DelayHistories(model).fill_controls(data.history, np.zeros(model.nu))
    found = []
    data.ctrl[:] = 0.3
    for _ in range(steps):
        mujoco.mj_step(model, data)
        found.append(bool(np.abs(data.actuator_force).max() > 0.5))
    return found


@pytest.mark.parametrize(("delay", "late"), [(0.005, 1), (0.012, 2), (0.013, 3), (0.02, 4), (0.04, 8)])
def test_a_target_reaches_the_servo_after_the_steps_of_its_delay(delay: float, late: int) -> None:
    _, model = changed(only("action_delay", delay))
    assert reacts(model, 10).index(True) == late


def test_no_delay_is_none_though_there_is_room_for_one() -> None:
    _, model = changed(only("friction"))
    assert reacts(model, 1) == [True]


@pytest.mark.parametrize("steps", [1, 2, 3, 7])
def test_a_delay_never_changes_by_a_step_however_long_it_runs(steps: int) -> None:
    model = mujoco.MjModel.from_xml_string(ONE_MOTOR)
    model.actuator_delay[:] = in_steps(steps * 0.005, 0.005)
    data = mujoco.MjData(model)
    forces = np.zeros(15_000)
    for step in range(forces.size):
        data.ctrl[0] = step
        data.qpos[0] = 0.0
        data.qvel[0] = 0.0
        mujoco.mj_step(model, data)
        forces[step] = data.actuator_force[0]
    assert np.array_equal(forces[steps:], np.arange(forces.size - steps))


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.005, 1), (0.01, 2), (0.02, 4)])
def test_the_imu_reading_lags_by_the_drawn_number_of_steps(delay: float, late: int) -> None:
    told = []
    for ranges in (RandomisationRanges(), only("imu_delay", delay)):
        _, model = changed(ranges)
        data = forward(model, qvel=0.3)
        rows = []
        for _ in range(30):
            mujoco.mj_step(model, data)
            rows.append(data.sensordata.copy())
        told.append(np.array(rows))
    assert np.array_equal(told[1][late + 1 :], told[0][1 : len(told[0]) - late])


def test_a_history_begins_as_if_it_had_always_been_so() -> None:
    _, model = changed(replace(only("action_delay", 0.04), imu_delay=(0.04, 0.04)))
    data = mujoco.MjData(model)
    histories = DelayHistories(model)
    histories.fill_controls(data.history, np.linspace(-0.1, 0.1, model.nu))
    data.ctrl[:] = 9.0
    mujoco.mj_forward(model, data)
    gain = model.actuator_gainprm[:, 0]
    assert data.actuator_force == pytest.approx(gain * np.linspace(-0.1, 0.1, model.nu))
    assert not data.sensordata.any()  # a reset leaves zeros in it
    histories.fill_sensors(data.history, np.arange(1.0, 11.0))
    for _ in range(8):
        mujoco.mj_step(model, data)
        assert np.array_equal(data.sensordata, np.arange(1.0, 11.0))
    mujoco.mj_step(model, data)
    assert not np.allclose(data.sensordata, np.arange(1.0, 11.0))


def test_a_model_without_room_for_the_delay_is_refused() -> None:
    model = body(history=3)
    with pytest.raises(
        ValueError, match=r"the actuators keep 3 samples, a delay of 0\.02 s needs 4: compile"
    ):
        PhysicsRandomiser(only("action_delay", 0.02), model, places(model))


def test_a_delay_is_shortened_by_half_a_step() -> None:
    assert in_steps(0.0, 0.005) == 0.0
    assert in_steps(0.002, 0.005) == 0.0
    assert in_steps(0.01, 0.005) == pytest.approx(0.0075)


# --------------------------------------------------------------------------------------- the batch


def test_a_simulation_of_a_batch_runs_as_a_model_with_its_draw_bit_for_bit() -> None:
    ranges = load_ranges("default")
    count = 3
    model = body()
    at = places(model)
    physics = PhysicsRandomiser(ranges, model, at)
    batch = Batch(model, count, 1)
    applied = BatchModelWriter(physics, batch)
    draws = [drawn(ranges, seed) for seed in range(count)]
    applied.apply(np.arange(count), draws)
    alone = []
    for draw in draws:
        own = body()
        SingleModelWriter(physics, own).apply(draw)
        alone.append((own, mujoco.MjData(own)))
    batch.reset()
    for step in range(10):
        batch.ctrl[:] = control = 0.1 * np.sin(step + np.arange(JOINTS))
        batch.step(nstep=4)
        for sim, (own, data) in enumerate(alone):
            data.ctrl[:] = control
            mujoco.mj_step(own, data, 4)
            assert np.array_equal(batch.qpos[sim], data.qpos)
    assert differing(batch.get_model(1), alone[1][0]) == set()
    assert np.unique(batch.qpos[:, 20]).size == count


def test_a_new_draw_begins_from_the_model_as_compiled_not_from_the_last_draw() -> None:
    model = body()
    ranges = load_ranges("default")
    one = SingleModelWriter(PhysicsRandomiser(ranges, model, places(model)), model)
    for seed in (1, 2, 3):
        one.apply(drawn(ranges, seed))
    fresh = body()
    SingleModelWriter(PhysicsRandomiser(ranges, fresh, places(fresh)), fresh).apply(drawn(ranges, 3))
    assert differing(model, fresh) == set()


# --------------------------------------------------------------------------------------- the start


def began(**spans: tuple[float, float]) -> tuple[Any, Any, Any, EpisodeDraw]:
    """A model as drawn, qpos and qvel that an episode begins with, and the draw."""
    model = body()
    draw = drawn(replace(RandomisationRanges(), **spans))
    compiled = body()
    qpos, qvel = EpisodeStart(compiled, places(compiled), compiled.qpos0).state(draw)
    SingleModelWriter(
        PhysicsRandomiser(replace(RandomisationRanges(), **spans), model, places(model)), model
    ).apply(draw)
    return model, qpos, qvel, draw


def lowest(model: Any, qpos: Any) -> float:
    """m between the floor and what is nearest to it."""
    data = forward(model, qpos=qpos)
    floor = model.geom("floor").id
    return min(
        mujoco.mj_geomDistance(model, data, floor, geom, 10.0, None)
        for geom in range(model.ngeom)
        if geom != floor and model.geom_contype[geom]
    )


def test_without_offsets_an_episode_begins_in_the_pose_bit_for_bit() -> None:
    _, qpos, qvel, _ = began()
    assert np.array_equal(qpos, body().qpos0) and not qvel.any()


def test_an_episode_begins_off_the_pose_within_the_stops_and_on_the_floor() -> None:
    model, qpos, qvel, draw = began(
        start_joints=(-1.0, 1.0), start_tilt=(0.2, 0.3), start_velocity=(0.1, 0.2), encoder_zero=(0.1, 0.1)
    )
    low, high = model.jnt_range[1:].T
    assert ((qpos[7:] >= low - 1e-12) & (qpos[7:] <= high + 1e-12)).all()
    assert np.abs(qpos[7:]).max() > 0.5
    assert 2.0 * np.arccos(qpos[3]) == pytest.approx(np.hypot(*draw.start_tilt))
    assert np.array_equal(qvel[:2], draw.start_velocity) and not qvel[2:].any()
    assert lowest(model, qpos) == pytest.approx(0.0, abs=1e-6)


def test_encoder_offsets_keep_the_reported_pose_and_place_the_robot_on_the_floor() -> None:
    model, qpos, _, _ = began(encoder_zero=(-0.03, 0.03))
    inside = (np.abs(body().jnt_range[1:]) > 0.03).all(axis=1)
    assert inside.sum() > 15
    assert np.allclose(qpos[7:][inside], 0.0, atol=1e-12)
    assert lowest(model, qpos) == pytest.approx(0.0, abs=1e-6)
