"""A linkage as a table: joint angles on a grid of actuator angles, and the way back. Pure.

Scalars instead of arrays: a place forward costs some microseconds, a place back less than a hundred.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from math import inf, nan

import numpy as np

from twind.robot.arrays import Floats

Numbers = tuple[float, ...]
STEPS = 20  # of Newton within one cell: three or four do
CLOSE = 1e-9  # of a cell, or rad: what rounding may put on its other side
EXACT = 1e-12  # of a cell: where Newton has arrived


class LinkageTable:
    """Joint angles on a rectangular grid of actuator angles, multilinear between its places.

    One or two actuators: there det J is linear within a cell, so its sign at the corners is that of the cell.
    Keeps `transmission.Transmission`.
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
        """See `Transmission`. Outside straight on from the edge, so outside of what the table gives; where
        that leads back into it, nobody knows the place: NaN."""
        cell, share, beyond = self._at(actuators)
        found = np.array(cell.value(share) if cell else [nan] * len(self.axes))
        if cell is None or not any(beyond):
            return found
        found += np.array(cell.slopes(share)) @ np.array(beyond)
        return np.full_like(found, nan) if self.preimages(found) else found

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
        """See `Transmission`; between two cells that of the upper one, outside that of the nearest edge."""
        cell, share, _ = self._at(actuators)
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

    def _at(self, actuators: Floats) -> "tuple[_Cell | None, Numbers, Numbers]":
        """The cell of the nearest place, where in it, 0..1, and rad that are missing to it; None for NaN."""
        number, share, beyond = 0, [], []
        for axis, wanted in zip(self.axes, actuators.tolist(), strict=True):
            if not abs(wanted) < inf:
                return None, (), ()
            angle = min(max(wanted, axis[0]), axis[-1])
            beyond.append(wanted - angle if abs(wanted - angle) > CLOSE else 0.0)
            at = min(bisect_right(axis, angle) - 1, len(axis) - 2)
            number = number * (len(axis) - 1) + at
            share.append((angle - axis[at]) / (axis[at + 1] - axis[at]))
        return self._cells[number], tuple(share), tuple(beyond)

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
