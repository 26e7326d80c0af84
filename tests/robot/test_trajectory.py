"""A path that takes longer is the same path."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference, Trajectory


@examples(50)
@given(w.paths(), st.floats(1.0, 8.0), st.floats(0.0, 1.0))
def test_a_stretched_path_passes_the_same_places_slower(path: Trajectory, factor: float, u: float) -> None:
    start = path.position[0]
    rest = Reference(start, np.zeros_like(start), np.zeros_like(start))
    quick = interpolate(path, rest)
    slow = interpolate(path.stretched(factor), rest)
    assert slow.duration == pytest.approx(quick.duration * factor)
    for index in range(len(quick.coefficients)):
        begin, end = quick.time[index : index + 2]
        t = float(begin + u * (end - begin))
        fast = quick.inside(index, t)
        late = slow.inside(index, t * factor)
        T = float(end - begin)
        scale = max(1.0, *np.abs(path.position).ravel())
        assert late.position == pytest.approx(fast.position, abs=1e-6 * scale)
        assert late.velocity * factor == pytest.approx(fast.velocity, rel=1e-6, abs=1e-6 * scale / T)
        wanted = pytest.approx(fast.acceleration, rel=1e-6, abs=1e-6 * scale / T**2)
        assert late.acceleration * factor**2 == wanted


def test_stretching_keeps_what_is_commanded_and_leaves_the_original_alone() -> None:
    path = w.path([1.0, 2.0], [0.1, 0.2], [0.3, 0.0])
    longer = path.stretched(2.0)
    assert longer.time.tolist() == [2.0, 4.0]
    assert longer.commanded.tolist() == path.commanded.tolist()
    assert path.time.tolist() == [1.0, 2.0]
    assert longer.acceleration is None
