"""A tuning moves gains by bounded changes, and puts the old ones back whatever happens."""

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.exceptions import InvalidInput
from twind.tuning.gain_search import FACTOR, MOST, Gains, GainSearch
from twind.tuning.gain_tuning import tune
from twind.tuning.step_response import StepResponse

LIMITS = {"p": 16383.0, "i": 16383.0, "d": 16383.0}
BOUND = 0.1


def response(overshoot: float, iae: float, swings: int = 0) -> StepResponse:
    return StepResponse(0.15, overshoot, 0.1, 0.2, 0.0, swings, iae)


def soft(gains: Gains) -> StepResponse:
    """Better the stiffer, until it overshoots; damping helps against that."""
    return response(max(0.0, (gains["p"] - gains["d"]) / 8000.0), 100.0 / gains["p"] + gains["d"] / 1e6)


@dataclass
class Bench:
    plant: Callable[[Gains], StepResponse] = soft
    fails_at: int = 10**6  # steps until the connection is lost
    in_force: list[Gains] = field(default_factory=list)
    steps: int = 0
    restored: int = 0

    def apply(self, gains: Gains) -> None:
        assert not self.restored
        self.in_force.append(gains)

    def step(self, joint: str) -> StepResponse:
        self.steps += 1
        if self.steps > self.fails_at:
            raise ConnectionError(joint)
        return self.plant(self.in_force[-1])

    def restore(self) -> None:
        self.restored += 1


def search(**start: float) -> GainSearch:
    return GainSearch({"p": 200.0, "i": 0.0, "d": 0.0} | start, LIMITS, BOUND)


def test_a_soft_servo_becomes_stiffer_within_the_bound_of_overshoot() -> None:
    found = tune(Bench(), ["elbow"], search(), 10)
    assert found.proposal is not None and found.proposal.response is not None
    assert found.proposal.gains["p"] > 400.0
    assert found.proposal.response.overshoot <= BOUND


def test_a_servo_that_overshoots_is_calmed_first() -> None:
    found = tune(Bench(), ["elbow"], search(p=4000.0), 10)
    assert found.proposal is not None and found.proposal.response is not None
    assert found.proposal.response.overshoot <= BOUND


def test_an_integral_that_swings_is_lowered() -> None:
    def swinging(gains: Gains) -> StepResponse:
        return response(gains["i"] / 20000.0, 0.1, round(gains["i"] / 2000.0))

    found = tune(Bench(swinging), ["elbow"], search(p=800.0, i=10000.0), 8)
    assert found.proposal is not None
    assert found.proposal.gains["i"] <= 2000.0


def test_without_anything_better_nothing_is_proposed() -> None:
    found = tune(Bench(lambda _: response(0.0, 0.1)), ["elbow"], search(), 10)
    assert found.proposal is None
    hopeless = tune(Bench(lambda _: response(0.5, 0.1)), ["elbow"], search(), 10)
    assert hopeless.proposal is None


@given(
    st.floats(1.0, 16000.0),
    st.sampled_from([0.0, 40.0, 5000.0]),
    st.sampled_from([0.0, 100.0, 9000.0]),
    st.lists(
        st.tuples(st.floats(0.0, 0.9), st.floats(0.01, 1.0), st.integers(0, 4)), min_size=12, max_size=12
    ),
)
def test_every_try_is_one_bounded_change_of_an_earlier_one(
    p: float, i: float, d: float, seen: list[tuple[float, float, int]]
) -> None:
    answers = iter(seen)
    bench = Bench(lambda _: response(*next(answers)))
    tune(bench, ["elbow"], search(p=p, i=i, d=d), 12)
    first, *others = bench.in_force
    assert first == {"p": p, "i": i, "d": d}
    for place, gains in enumerate(others, 1):
        assert gains not in bench.in_force[:place]
        assert all(0.0 <= value <= LIMITS[name] for name, value in gains.items())
        assert p / MOST - 0.5 <= gains["p"] <= MOST * p + 0.5
        assert gains["i"] <= i
        assert any(_one_change(old, gains) for old in bench.in_force[:place])


def _one_change(old: Gains, new: Gains) -> bool:
    changed = [name for name in old if old[name] != new[name]]
    stiffness = old["p"] / FACTOR - 0.5 <= new["p"] <= old["p"] * FACTOR + 0.5
    damping = abs(new["d"] - old["d"]) <= max((FACTOR - 1.0) * old["d"], 0.5 * old["p"]) + 0.5
    return len(changed) == 1 and stiffness and damping


@given(st.integers(0, 7))
def test_whatever_ends_a_tuning_the_old_gains_come_back_once(fails_at: int) -> None:
    bench = Bench(fails_at=fails_at)
    with pytest.raises(ConnectionError):
        tune(bench, ["elbow", "wrist"], search(), 10)
    assert bench.restored == 1
    bench = Bench()
    tune(bench, ["elbow", "wrist"], search(), 3)
    assert bench.restored == 1


def test_a_try_that_overshoots_far_ends_before_the_next_joint() -> None:
    bench = Bench(lambda _: response(0.9, 0.1))
    tune(bench, ["elbow", "wrist"], search(), 1)
    assert bench.steps == 1


def test_a_compliance_slope_cannot_be_tuned() -> None:
    with pytest.raises(InvalidInput, match="slope"):
        GainSearch({"slope": 32.0}, {"slope": 254.0}, BOUND)
