"""A linkage as a table: joint angles on a grid of actuator angles, and the inverse. Pure.

Scalars instead of arrays: a forward evaluation takes some microseconds, an inverse one less than a hundred.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise, product
from math import inf, nan

import numpy as np

from twind.robot.arrays import Bools, Floats, corners
from twind.robot.table_cells import CLOSE, CellIndex, Numbers, TableCell


class LinkageTable:
    """Joint angles on a rectangular grid of actuator angles, multilinear between its places.

    One or two actuators: there det J is linear within a cell, so its sign at the corners is that of the cell.
    It has the interface `transmission.Transmission`.
    """

    def __init__(self, axes: Sequence[Sequence[float]], values: Sequence[Sequence[float]]) -> None:
        """`axes`: ascending actuator angles.

        `values`: the k joint angles of each place, last axis fastest.

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
        self._finder = CellIndex(self._cells)
        self._lines = _GridLines(self.axes, self.values) if len(self.axes) == 2 else None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LinkageTable) and (self.axes, self.values) == (other.axes, other.values)

    def __hash__(self) -> int:
        return hash((self.axes, self.values))

    def __str__(self) -> str:
        return f"table of {' x '.join(map(str, self.shape))} places"

    def forward(self, actuators: Floats) -> Floats:
        """See `Transmission`. Outside the grid it continues in a straight line from the edge.

        Where that line leads back into the table, the place is unknown: NaN.
        """
        cell, share, beyond = self._at(actuators)
        found = np.array(cell.value(share) if cell else [nan] * len(self.axes))
        if cell is None or not any(beyond):
            return found
        found += np.array(cell.slopes(share)) @ np.array(beyond)
        return found if np.isnan(self.inverse(found)).all() else np.full_like(found, nan)

    def inverse(self, joints: Floats) -> Floats:
        """Find the actuator angles by Newton's method, in each cell that may hold the joint angles."""
        found = next(self._preimages(joints), None)
        return np.full(len(self.axes), nan) if found is None else np.array(found)

    def preimages(self, joints: Floats) -> list[Floats]:
        """Return all actuator angles that give these joint angles: one, where the table can be inverted.

        A place on the edge of several cells is found in each of them.
        """
        return [np.array(place) for place in self._preimages(joints)]

    def extremes(self, lower: Floats, upper: Floats) -> Floats:
        """See `Transmission`: the corners of the box, and where its edges cross the lines of the grid.

        Along an edge within a cell both actuator angles only rise or only fall (s and t are there on one
        branch of c + x s + y t + z s t = const). No place inside the box goes beyond all of its edges.
        """
        found = [self.inverse(corner) for corner in corners(lower, upper)]
        if self._lines is not None:
            for joint, other in ((0, 1), (1, 0)):
                for edge in (lower[joint], upper[joint]):
                    found += self._crossings(self._lines, joint, edge, (lower[other], upper[other]))
        return np.array(found)

    def _crossings(
        self, lines: "_GridLines", joint: int, edge: float, ends: tuple[float, float]
    ) -> list[Floats]:
        """Return actuator angles on a line of the grid with one joint at `edge`.

        The other joint is within `ends`. Where that edge of a box has left the table, and comes back, an
        unknown place (NaN) is added.
        """
        actuators, across, outer = lines.crossed(joint, edge, ends)
        found = list(actuators)
        for at in np.flatnonzero(outer[:-1] & outer[1:]).tolist():
            between = np.full(2, edge)
            between[1 - joint] = 0.5 * (across[at] + across[at + 1])
            found.append(self.inverse(between))
        return found

    def jacobian(self, actuators: Floats) -> Floats:
        """See `Transmission`; between two cells that of the upper one, outside that of the nearest edge."""
        cell, share, _ = self._at(actuators)
        return np.array(cell.slopes(share)) if cell else np.full((len(self.axes), len(self.axes)), nan)

    @cached_property
    def slopes(self) -> Floats:
        """See `Transmission`; computed once, as a table has thousands of places."""
        return np.array([self.jacobian(place) for place in self.places])

    @property
    def places(self) -> Floats:
        """Places just inside the corners of every cell."""
        shares = np.array(np.meshgrid(*[[CLOSE, 1.0 - CLOSE]] * len(self.axes))).reshape(len(self.axes), -1).T
        return np.array([cell.angles(share) for cell in self._cells for share in shares.tolist()])

    @property
    def checked(self) -> Floats:
        """Every place of the grid and the middle of every cell: where the inverse is checked."""
        grid = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, len(self.axes))
        middles = [cell.angles([0.5] * len(self.axes)) for cell in self._cells]
        return np.concatenate([grid, np.array(middles)])

    def _at(self, actuators: Floats) -> tuple[TableCell | None, Numbers, Numbers]:
        """Return the cell of the nearest place, the place in it, 0..1, and the rest, rad; None for NaN."""
        number = 0
        share = []
        beyond = []
        for axis, wanted in zip(self.axes, actuators.tolist(), strict=True):
            if not abs(wanted) < inf:
                return None, (), ()
            angle = min(max(wanted, axis[0]), axis[-1])
            beyond.append(wanted - angle if abs(wanted - angle) > CLOSE else 0.0)
            at = min(bisect_right(axis, angle) - 1, len(axis) - 2)
            number = number * (len(axis) - 1) + at
            share.append((angle - axis[at]) / (axis[at + 1] - axis[at]))
        return self._cells[number], tuple(share), tuple(beyond)

    def _preimages(self, joints: Floats) -> Iterator[Numbers]:
        wanted = joints.tolist()
        for cell in self._finder.near(wanted):
            found = cell.solve(wanted) if cell.may_hold(wanted) else None
            if found is not None:
                yield found

    def _made_cells(self) -> list[TableCell]:
        values = np.array(self.values).reshape(*self.shape, len(self.axes))
        cells = []
        for index in np.ndindex(*[length - 1 for length in self.shape]):
            corner = tuple(axis[at] for axis, at in zip(self.axes, index, strict=True))
            size = tuple(axis[at + 1] - axis[at] for axis, at in zip(self.axes, index, strict=True))
            block = values[tuple(slice(at, at + 2) for at in index)].reshape(-1, len(self.axes))
            cells.append(TableCell(corner, size, block.tolist()))
        return cells


class _GridLines:
    """The lines of a grid of two axes, from each place to the next."""

    def __init__(self, axes: Sequence[Numbers], values: Sequence[Numbers]) -> None:
        """`values`: the joint angles of each place, last axis fastest."""
        rows, columns = (len(axis) for axis in axes)
        place = np.arange(rows * columns).reshape(rows, columns)
        ends = [
            np.concatenate([place[:-1].ravel(), place[:, :-1].ravel()]),
            np.concatenate([place[1:].ravel(), place[:, 1:].ravel()]),
        ]
        self.actuators = np.array(list(product(*axes)))[ends]  # (2, lines, 2), rad at both ends
        self.joints = np.array(values)[ends]
        self._rise = self.joints[1] - self.joints[0]
        row, column = np.divmod(ends[0], columns)
        along = np.arange(len(row)) < (rows - 1) * columns  # the first axis
        self.outer: Bools = np.where(along, np.isin(column, (0, columns - 1)), np.isin(row, (0, rows - 1)))

    def crossed(self, joint: int, edge: float, ends: tuple[float, float]) -> tuple[Floats, Floats, Bools]:
        """Return crossings where one joint is at `edge` and the other within `ends`, in its order.

        Result: actuator angles (m, 2), the other joint's angle (m,), and whether the table ends there (m,). A
        line is straight for the joints too.
        """
        start = self.joints[0]
        rise = self._rise
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            share = (edge - start[:, joint]) / rise[:, joint]
        met = (share >= -CLOSE) & (share <= 1.0 + CLOSE)  # a line along the edge meets the lines across
        share = np.where(met, np.clip(share, 0.0, 1.0), 0.0)
        across = start[:, 1 - joint] + share * rise[:, 1 - joint]
        rows = np.flatnonzero(met & (across >= ends[0]) & (across <= ends[1]))
        rows = rows[np.argsort(across[rows])]
        low, high = self.actuators[:, rows]
        return low + share[rows, None] * (high - low), across[rows], self.outer[rows]
