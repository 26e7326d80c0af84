"""From actuators to joints where several turn them together: differentials and linkages. Pure.

Angles are rad: of k actuators after zero, sign and ratio, and of the k joints they drive, each in the order
of the robot file. A place that nobody knows (outside a table, NaN) is NaN, both ways. The arithmetic:

position  q = F(a)        a = F⁻¹(q)
velocity  dq = J da       J = dF/da at the place
effort    τ_a = Jᵀ τ_q    τ_q = J⁻ᵀ τ_a    (no power is lost: τ_a · da = τ_q · dq)
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from math import nan
from typing import Protocol

import numpy as np

from twind.robot.arrays import Floats

Numbers = tuple[float, ...]
MOST_CONDITION = 100.0  # beyond it one per cent of an actuator's angle or torque may be all of a joint's
STEPS = 20  # of Newton within one cell: three or four do
CLOSE = 1e-9  # of a cell, or rad: what rounding may put on its other side
EXACT = 1e-12  # of a cell: where Newton has arrived
EDGE = 25  # places along each edge of a box of joint angles


class Transmission(Protocol):
    """What drives k joints by k actuators. Two are equal when they do the same."""

    def forward(self, actuators: Floats) -> Floats:
        """Joint angles (k,) at actuator angles (k,); NaN where they are not known."""

    def inverse(self, joints: Floats) -> Floats:
        """Actuator angles (k,) at joint angles (k,); NaN where no actuator angles give them."""

    def jacobian(self, actuators: Floats) -> Floats:
        """dq/da (k, k) at actuator angles (k,): joints in rows."""

    @property
    def places(self) -> Floats:
        """Actuator angles (m, k) at which `jacobian` takes its extreme values."""

    @property
    def curved(self) -> bool:
        """Whether a box of joint angles maps into more than what its corners span."""


class Differential:
    """joint = C · actuator, with C invertible."""

    curved = False

    def __init__(self, rows: Sequence[Sequence[float]]) -> None:
        """`rows` of C, one per joint. Raises ValueError: not square, not finite, not invertible."""
        self.rows = tuple(tuple(float(number) for number in row) for row in rows)
        if not self.rows or any(len(row) != len(self.rows) for row in self.rows):
            raise ValueError(f"{len(self.rows)} rows of {[len(row) for row in self.rows]} are not square")
        self._matrix = np.array(self.rows, np.float64)
        try:
            self._back = np.linalg.inv(self._matrix)
        except np.linalg.LinAlgError:
            raise ValueError("the matrix has no inverse") from None
        if not (np.isfinite(self._matrix).all() and np.isfinite(self._back).all()):
            raise ValueError("the matrix is not finite")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Differential) and self.rows == other.rows

    def __hash__(self) -> int:
        return hash(self.rows)

    def __str__(self) -> str:
        return f"joint = {[list(row) for row in self.rows]} . actuator"

    def forward(self, actuators: Floats) -> Floats:
        """See `Transmission`."""
        found: Floats = self._matrix @ actuators
        return found

    def inverse(self, joints: Floats) -> Floats:
        """See `Transmission`."""
        found: Floats = self._back @ joints
        return found

    def jacobian(self, actuators: Floats) -> Floats:
        """See `Transmission`."""
        return self._matrix

    @property
    def places(self) -> Floats:
        """Any: the matrix is the same everywhere."""
        return np.zeros((1, len(self.rows)))


class LinkageTable:
    """Joint angles on a rectangular grid of actuator angles, multilinear between its places, NaN outside.

    One or two actuators: there det J is linear within a cell, so its sign at the corners is that of the cell.
    Scalars instead of arrays: a place costs some microseconds.
    """

    curved = True

    def __init__(self, axes: Sequence[Sequence[float]], values: Sequence[Sequence[float]]) -> None:
        """`axes`: ascending actuator angles; `values`: the k joint angles of each place, last axis fastest.

        Raises ValueError: another number of places, fewer than two on an axis, an axis that does not ascend.
        """
        self.axes: tuple[Numbers, ...] = tuple(tuple(map(float, axis)) for axis in axes)
        self.values: tuple[Numbers, ...] = tuple(tuple(map(float, row)) for row in values)
        if len(self.axes) not in (1, 2):
            raise ValueError(f"a table has one or two actuators, not {len(self.axes)}")
        for axis in self.axes:
            if len(axis) < 2 or not all(a < b for a, b in pairwise(axis)):
                raise ValueError("an axis needs two places at least, ascending")
        self.shape = tuple(len(axis) for axis in self.axes)
        if len(self.values) != np.prod(self.shape) or any(len(row) != len(axes) for row in self.values):
            raise ValueError(f"{len(self.values)} places are not the grid of {self.shape}")
        if not np.isfinite(np.array(self.values)).all() or not all(map(np.isfinite, self.axes[0])):
            raise ValueError("every number of a table must be finite")
        self._cells = self._made_cells()
        boxes = np.array([[cell.low, cell.high] for cell in self._cells])
        self._low, self._high = boxes[:, 0], boxes[:, 1]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LinkageTable) and (self.axes, self.values) == (other.axes, other.values)

    def __hash__(self) -> int:
        return hash((self.axes, self.values))

    def __str__(self) -> str:
        return f"table of {' x '.join(map(str, self.shape))} places"

    def forward(self, actuators: Floats) -> Floats:
        """See `Transmission`."""
        cell, share = self._at(actuators)
        return np.array(cell.value(share) if cell else [nan] * len(self.axes))

    def inverse(self, joints: Floats) -> Floats:
        """By Newton, bounded to one cell after the other of those that may hold it."""
        found = self.preimages(joints)
        return found[0] if found else np.full(len(self.axes), nan)

    def preimages(self, joints: Floats) -> list[Floats]:
        """All actuator angles that give these joint angles: one, where the table can be inverted.

        A place on the edge of several cells is found in each of them.
        """
        slack = CLOSE * (self._high - self._low)
        inside = ((joints >= self._low - slack) & (joints <= self._high + slack)).all(axis=1)
        wanted = [float(joint) for joint in joints]
        found = (self._cells[number].solve(wanted) for number in np.flatnonzero(inside).tolist())
        return [np.array(place) for place in found if place is not None]

    def jacobian(self, actuators: Floats) -> Floats:
        """See `Transmission`; between two cells that of the upper one, NaN outside."""
        cell, share = self._at(actuators)
        return np.array(cell.slopes(share)) if cell else np.full((len(self.axes), len(self.axes)), nan)

    @property
    def places(self) -> Floats:
        """Just inside the corners of every cell."""
        shares = np.array(np.meshgrid(*[[CLOSE, 1.0 - CLOSE]] * len(self.axes))).reshape(len(self.axes), -1).T
        return np.array([cell.angles(share) for cell in self._cells for share in shares.tolist()])

    @property
    def checked(self) -> Floats:
        """Every place of the grid and the middle of every cell: where the inverse is proved."""
        grid = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, len(self.axes))
        middles = [cell.angles([0.5] * len(self.axes)) for cell in self._cells]
        return np.concatenate([grid, np.array(middles)])

    def _at(self, actuators: Floats) -> "tuple[_Cell | None, Numbers]":
        """The cell of a place and where in it, 0..1; None outside and for NaN."""
        number, share = 0, []
        for axis, angle in zip(self.axes, actuators.tolist(), strict=True):
            if not axis[0] - CLOSE <= angle <= axis[-1] + CLOSE:
                return None, ()
            angle = min(max(angle, axis[0]), axis[-1])
            at = min(bisect_right(axis, angle) - 1, len(axis) - 2)
            number = number * (len(axis) - 1) + at
            share.append((angle - axis[at]) / (axis[at + 1] - axis[at]))
        return self._cells[number], tuple(share)

    def _made_cells(self) -> "list[_Cell]":
        values = np.array(self.values).reshape(*self.shape, len(self.axes))
        cells = []
        for index in np.ndindex(*[length - 1 for length in self.shape]):
            corner = tuple(axis[at] for axis, at in zip(self.axes, index, strict=True))
            size = tuple(axis[at + 1] - axis[at] for axis, at in zip(self.axes, index, strict=True))
            block = values[tuple(slice(at, at + 2) for at in index)].reshape(-1, len(self.axes))
            cells.append(_Cell(corner, size, block.tolist()))
        return cells


class _Cell:
    """One cell of a table: value = c + x s + y t + z s t, s, t in 0..1 across it; of one axis y = z = 0."""

    def __init__(self, corner: Numbers, size: Numbers, block: list[list[float]]) -> None:
        """`block`: the values at its corners, last axis fastest."""
        self.corner, self.size = corner, size
        self.low, self.high = ([edge(column) for column in zip(*block, strict=True)] for edge in (min, max))
        if len(corner) == 1:
            self._terms = [(a, b - a, 0.0, 0.0) for a, b in zip(*block, strict=True)]
        else:
            self._terms = [(a, c - a, b - a, d - c - b + a) for a, b, c, d in zip(*block, strict=True)]

    def angles(self, share: Sequence[float]) -> Numbers:
        """Actuator angles at a share of the cell."""
        return tuple(a + s * w for a, s, w in zip(self.corner, share, self.size, strict=True))

    def value(self, share: Sequence[float]) -> list[float]:
        """Joint angles there."""
        s, t = share[0], share[-1] if len(share) == 2 else 0.0
        return [c + x * s + y * t + z * s * t for c, x, y, z in self._terms]

    def slopes(self, share: Sequence[float]) -> list[list[float]]:
        """dq/da there."""
        if len(share) == 1:
            return [[self._terms[0][1] / self.size[0]]]
        (s, t), (width, height) = share, self.size
        return [[(x + z * t) / width, (y + z * s) / height] for _, x, y, z in self._terms]

    def solve(self, wanted: list[float]) -> Numbers | None:
        """Actuator angles within this cell that give these joint angles; None: there are none."""
        share = [0.5] * len(self.corner)
        for _ in range(STEPS):
            step = self._newton(share, wanted)
            if step is None:
                return None
            share = [min(max(s + d, -0.5), 1.5) for s, d in zip(share, step, strict=True)]
            if max(map(abs, step)) < EXACT:
                break
        inside = all(-CLOSE <= s <= 1.0 + CLOSE for s in share)
        wrong = self._newton(share, wanted) if inside else None
        if wrong is None or max(map(abs, wrong)) > CLOSE:
            return None
        return self.angles([min(max(s, 0.0), 1.0) for s in share])

    def _newton(self, share: list[float], wanted: list[float]) -> list[float] | None:
        """The next step, in shares of the cell; None where there is none."""
        miss = [w - v for w, v in zip(wanted, self.value(share), strict=True)]
        if len(share) == 1:
            slope = self._terms[0][1]
            return [miss[0] / slope] if slope else None
        s, t = share
        (a, b), (c, d) = ((x + z * t, y + z * s) for _, x, y, z in self._terms)
        det = a * d - b * c
        if not det:
            return None
        return [(d * miss[0] - b * miss[1]) / det, (a * miss[1] - c * miss[0]) / det]


# ------------------------------------------------------------------------------------------- what follows


def condition(law: Transmission) -> float:
    """The worst condition number of its Jacobian; inf where it cannot be inverted."""
    numbers = [float(np.linalg.cond(law.jacobian(place))) for place in law.places]
    return max(numbers) if np.isfinite(numbers).all() else float("inf")


def forth(law: Transmission) -> Floats:
    """(k, k): how far each joint (row) moves at most per rad of each actuator, by amount."""
    found: Floats = np.max([np.abs(law.jacobian(place)) for place in law.places], axis=0)
    return found


def back(law: Transmission) -> Floats:
    """(k, k): how far each actuator (row) must move at most per rad of each joint, by amount."""
    found: Floats = np.max([np.abs(np.linalg.inv(law.jacobian(place))) for place in law.places], axis=0)
    return found


def fair(share: Floats, bound: Floats, own: Floats) -> Floats:
    """What each joint (k,) may at most, so that all at once ask no actuator for more than `bound` (k,).

    share @ result <= bound and result <= `own` (k,): each joint as much as it may alone, all less in one
    proportion. NaN bounds give NaN.
    """
    with np.errstate(divide="ignore"):
        alone = np.minimum((bound[:, None] / share).min(axis=0), own)
        return np.asarray(alone * np.minimum(1.0, (bound / (share @ alone)).min()))


def span(law: Transmission, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Least and largest actuator angles (k,) while the joints stay in lower..upper (k,); NaN: not known.

    They are taken at the edge of that box: of a matrix at its corners, of a table at places along it.
    """
    lines = [
        np.linspace(low, high, EDGE if law.curved else 2) for low, high in zip(lower, upper, strict=True)
    ]
    box = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, len(lines))
    edge = box[((box == lower) | (box == upper)).any(axis=1)]
    angles = np.array([law.inverse(place) for place in edge])
    return angles.min(axis=0), angles.max(axis=0)
