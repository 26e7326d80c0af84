"""Proof that a whole curve keeps its distance (SELF_COLLISION, KEEP_OUT), also between samples.

A joint turns by no more than the length of its control polygon, and no two geoms come closer by more than
lever x angle (`lever_bounds.py`). Let two poses with distances d and e lie L of such motion apart. The curve
between them is clear of `block` if (d + e - L) / 2 > block; an unproved piece is halved. No clear verdict is
wrong. A curve is refused wrongly only where its true clearance is within `BAND` above `block`.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.splines import Spline
from twind.safety.polynomial_bounds import halves
from twind.twin.collision_model import CollisionModel

BAND = 1e-4  # m above `block` in which a curve may be refused although it is clear
SLACK = 5e-4  # m: a start that is too close already may be left by a way that comes closer by this much
SHARE = 0.6  # of the motion that two poses out of `reach` would allow between them
CHUNK = 64  # pieces between two yields: 0.3 to 1 ms
FAR = 1.0  # m: range in which boxes are measured
MOST = 60_000  # poses and measurements of one curve: some 0.4 s; a curve that needs more is refused


@dataclass(frozen=True, slots=True)
class CloseGeoms:
    """Two geoms too close, or nearly so."""

    pair: int  # place in `CollisionModel.pairs`
    time: float  # s on the curve: the first moment of the approach
    clearance: float  # m, the least clearance found
    at: float  # s, the time of it


@dataclass(frozen=True, slots=True)
class SweepResult:
    """Result of the sweep of one curve."""

    refused: tuple[CloseGeoms, ...]  # in order of time
    warned: tuple[CloseGeoms, ...]  # nearer than the band beyond `block` at a sample
    work: int  # poses and measurements
    unfinished: bool  # more than `MOST` was needed: not proved


@dataclass(slots=True)
class _UnprovedPieces:
    """Pairs not proved yet on a piece: piece (r,), pair (r,), distances at its ends, bound (m)."""

    piece: Ints
    pair: Ints
    first: Floats
    last: Floats
    bound: Floats

    def take(self, chosen: Bools) -> "_UnprovedPieces":
        first = self.first[chosen]
        last = self.last[chosen]
        bound = self.bound[chosen]
        return _UnprovedPieces(self.piece[chosen], self.pair[chosen], first, last, bound)


@dataclass(slots=True)
class _CurvePieces:
    """Stretches of the curve as Bernstein coefficients (degree + 1, i, n), over time[0]..time[1] (i,), s."""

    curve: Floats
    start: Floats
    end: Floats

    def motion(self) -> Floats:
        """Return the most that each joint turns, rad, (i, n)."""
        turned: Floats = np.abs(np.diff(self.curve, axis=0)).sum(axis=0)
        return turned

    def take(self, chosen: Bools | Ints | slice) -> "_CurvePieces":
        return _CurvePieces(self.curve[:, chosen], self.start[chosen], self.end[chosen])

    def split(self) -> "_CurvePieces":
        """Split each piece in two, in their order."""
        left, right = halves(self.curve)
        middle = 0.5 * (self.start + self.end)
        shape = (len(left), 2 * len(middle), left.shape[2])
        both = np.stack([left, right], axis=2).reshape(shape)
        starts = np.stack([self.start, middle], 1)
        ends = np.stack([middle, self.end], 1)
        return _CurvePieces(both, starts.ravel(), ends.ravel())


def bernstein(curve: Spline) -> _CurvePieces:
    """Return the segments of a spline as pieces."""
    powers = curve.coefficients
    T = np.diff(curve.time)
    degree = powers.shape[1] - 1
    scaled = powers * (T[:, None] ** np.arange(degree + 1))[:, :, None]
    turn = np.array(
        [
            [comb(k, i) / comb(degree, i) if i <= k else 0.0 for i in range(degree + 1)]
            for k in range(degree + 1)
        ]
    )
    return _CurvePieces(np.einsum("ki,sin->ksn", turn, scaled), curve.time[:-1], curve.time[1:])


def _groups(share: Floats) -> Ints:
    """Return the last piece of each group of pieces that together move by a share of at most 1.

    A single piece may move by more.
    """
    ends = []
    total = 0.0
    for piece, part in enumerate(share.tolist()):
        if piece and not total + part <= 1.0:
            ends.append(piece - 1)
            total = 0.0
        total += part
    return np.array([*ends, len(share) - 1], np.int64)


class CurveSweep:
    """Sweep of one curve, in slices."""

    def __init__(self, bodies: CollisionModel) -> None:
        self._bodies = bodies
        self.work = 0
        self._bound = bodies.block.copy()
        self._leaving = np.zeros(len(bodies.pairs), np.bool_)  # too close at the start, and not yet clear
        self._bad: dict[int, CloseGeoms] = {}
        self._least = np.full(len(bodies.pairs), np.inf)
        self._when = np.zeros(len(bodies.pairs))
        self._near_since = np.full(len(bodies.pairs), np.inf)

    def running(self, curve: Spline) -> Generator[None, None, SweepResult]:
        """Judge `curve`, yielding after every `CHUNK` poses or so. Anything not finite is refused."""
        pieces = self._fine(bernstein(curve)) if len(curve.coefficients) else None
        if pieces is None or not np.isfinite(pieces.curve).all():
            moves = len(curve.coefficients) > 0
            self._begin(self._measured(curve.end))
            return self._result(unfinished=moves)
        row = self._measured(pieces.curve[0, 0])
        self._begin(row)
        for first in range(0, len(pieces.start), CHUNK):
            if self.work > MOST:
                return self._result(unfinished=True)
            chunk = pieces.take(slice(first, first + CHUNK))
            row = yield from self._chunk(chunk, row)
            yield
        return self._result(unfinished=self.work > MOST)

    def standing(self, position: Sequence[float]) -> SweepResult:
        """Judge one pose (n,): a pair closer than `block` is refused, even if it could be left from there."""
        self._note(self._measured(np.array(position, np.float64))[None], np.zeros(1))
        for pair in np.flatnonzero(~(self._least > self._bodies.block)):
            self._bad[int(pair)] = CloseGeoms(int(pair), 0.0, 0.0, 0.0)
        return self._result(unfinished=False)

    # ------------------------------------------------------------------------------- pieces

    def _fine(self, pieces: _CurvePieces) -> _CurvePieces | None:
        """Halve the pieces until no pair can cross the reach unseen; None where that takes too many."""
        bodies = self._bodies
        most = SHARE * 2.0 * (bodies.reach - bodies.block)
        while True:
            with np.errstate(all="ignore"):
                # The bound applies to the pair that the piece moves most.
                wide: Bools = np.any(~(pieces.motion() @ bodies.levers.T <= most), axis=1)
            if not wide.any():
                return pieces
            if len(wide) + np.count_nonzero(wide) > MOST or not np.isfinite(pieces.curve).all():
                return None
            parts = pieces.take(wide).split()
            times = np.concatenate([pieces.start[~wide], parts.start])
            order = np.argsort(times, kind="stable")
            pieces = _CurvePieces(
                np.concatenate([pieces.curve[:, ~wide], parts.curve], axis=1)[:, order],
                times[order],
                np.concatenate([pieces.end[~wide], parts.end])[order],
            )

    def _chunk(self, pieces: _CurvePieces, row: Floats) -> Generator[None, None, Floats]:
        """Judge some pieces, the first of which begins at distances `row` (p,).

        Return the distances at their end.

        Poses are measured only where enough motion has accumulated; an unproved group is judged piece by
        piece.
        """
        bodies = self._bodies
        moved = pieces.motion() @ bodies.levers.T
        share = (moved / (SHARE * 2.0 * (bodies.reach - bodies.block))).max(axis=1)
        ends = _groups(share)
        starts = np.concatenate([[0], ends[:-1] + 1])
        poses = pieces.curve[-1, ends]
        together = np.add.reduceat(moved, starts, axis=0)
        bodies.place(poses[-1])
        last = np.array([bodies.between(pair, FAR) for pair in bodies.boxes])
        near = ~(row[bodies.boxes] + last - together[:, bodies.boxes].sum(axis=0) > 2.0 * bodies.reach)
        rows = np.vstack([row, bodies.distances(poses, bodies.boxes[near], FAR)])
        rows[-1, bodies.boxes] = last
        self.work += len(poses)
        self._note(rows[1:], pieces.end[ends])
        bound = self._bounds(rows)
        unproved = ~(rows[:-1] + rows[1:] - together > 2.0 * bound)
        if self._bad:
            self._mark(pieces.end[ends], rows, bound)
        elif unproved.any():
            left = self._taken_apart(pieces, starts, ends, rows, bound, unproved)
            yield
            yield from self._close_in(pieces, left)
        end: Floats = rows[-1]
        return end

    def _taken_apart(
        self, pieces: _CurvePieces, starts: Ints, ends: Ints, rows: Floats, bound: Floats, unproved: Bools
    ) -> _UnprovedPieces:
        """Return the pairs that a whole group does not prove, at every piece of the group."""
        bodies = self._bodies
        found: list[tuple[int, int, float, float, float]] = []
        for group in np.flatnonzero(unproved.any(axis=1)):
            pairs = np.flatnonzero(unproved[group])
            first = rows[group, pairs]
            inside = range(int(starts[group]), int(ends[group]))
            for piece in (*inside, int(ends[group])):
                last = rows[group + 1, pairs]
                if piece in inside:
                    bodies.place(pieces.curve[-1, piece])
                    last = np.array([bodies.between(int(pair), FAR) for pair in pairs])
                    self._note_rows(pairs, last, np.full(len(pairs), pieces.end[piece]))
                    self.work += len(pairs)
                found += zip([piece] * len(pairs), pairs, first, last, bound[group, pairs], strict=True)
                first = last
        columns = list(zip(*found, strict=True))
        places = np.array(columns[0]), np.array(columns[1])
        return _UnprovedPieces(*places, np.array(columns[2]), np.array(columns[3]), np.array(columns[4]))

    def _close_in(self, pieces: _CurvePieces, rows: _UnprovedPieces) -> Generator[None, None, None]:
        """Halve the unproved pieces until each is proved, or found too close."""
        bodies = self._bodies
        levers = self._bodies.levers
        since = 0
        while True:
            moved = np.einsum("rn,rn->r", levers[rows.pair], pieces.motion()[rows.piece])
            rows_open = ~(rows.first + rows.last - moved > 2.0 * rows.bound)
            bad = rows_open & ~((rows.first > rows.bound) & (rows.last > rows.bound) & (moved > 2.0 * BAND))
            for place in np.flatnonzero(bad):
                self._found(pieces, rows, int(place))
            early = np.array([self._bad_since(pair) for pair in rows.pair.tolist()])
            rows = rows.take(rows_open & ~bad & (pieces.start[rows.piece] < early))
            if not len(rows.pair) or self.work > MOST:
                return
            used, piece = np.unique(rows.piece, return_inverse=True)
            pieces = pieces.take(used).split()
            middle = np.empty(len(piece))
            order = np.argsort(piece, kind="stable")
            at = -1
            for place in order:
                if piece[place] != at:
                    at = int(piece[place])
                    bodies.place(pieces.curve[-1, 2 * at])
                middle[place] = bodies.between(int(rows.pair[place]), FAR)
            self.work += len(middle)
            self._note_rows(rows.pair, middle, pieces.end[2 * piece])
            rows = _UnprovedPieces(
                np.concatenate([2 * piece, 2 * piece + 1]),
                np.tile(rows.pair, 2),
                np.concatenate([rows.first, middle]),
                np.concatenate([middle, rows.last]),
                np.tile(rows.bound, 2),
            )
            since += len(middle)
            if since > CHUNK // 2:
                since = 0
                yield

    # ------------------------------------------------------------------------------- findings

    def _measured(self, position: Floats) -> Floats:
        """Return distances (p,) of one pose, with those of boxes."""
        bodies = self._bodies
        row: Floats = bodies.distances(position[None], bodies.boxes, FAR)[0]
        return row

    def _begin(self, row: Floats) -> None:
        """Start the sweep; a pair that is too close already may only be left."""
        self._leaving = row < self._bodies.block + BAND
        self._bound = np.where(self._leaving, np.minimum(row - SLACK, self._bodies.block), self._bodies.block)
        self._note(row[None], np.zeros(1))

    def _bounds(self, rows: Floats) -> Floats:
        """Return the bound of each piece and pair (i, p), m.

        It is `block`, but lower while a pair leaves its start.
        """
        block = np.broadcast_to(self._bodies.block, (len(rows) - 1, len(self._bound)))
        if not self._leaving.any():
            return block
        out = np.logical_or.accumulate(rows >= self._bodies.block + BAND, axis=0)
        bound = np.where(self._leaving & ~out[:-1], self._bound, block)
        self._leaving &= ~out[-1]
        return bound

    def _note(self, rows: Floats, times: Floats) -> None:
        """Note samples (k, p) at times (k,): the least of each pair, and since when it is near."""
        place = rows.argmin(axis=0)
        least = rows[place, np.arange(rows.shape[1])]
        lower = least < self._least
        self._least[lower] = least[lower]
        self._when[lower] = times[place[lower]]
        near = rows < self._bodies.block + self._bodies.band
        if near.any():
            first = np.where(near.any(axis=0), times[near.argmax(axis=0)], np.inf)
            np.minimum(self._near_since, first, out=self._near_since)

    def _bad_since(self, pair: int) -> float:
        return self._bad[pair].time if pair in self._bad else np.inf

    def _note_rows(self, pair: Ints, distance: Floats, times: Floats) -> None:
        lower = distance < self._least[pair]
        for p, d, t in zip(pair[lower], distance[lower], times[lower], strict=True):
            if d < self._least[p]:
                self._least[p] = d
                self._when[p] = t
        near = distance < self._bodies.block[pair] + self._bodies.band
        np.minimum.at(self._near_since, pair[near], times[near])

    def _mark(self, times: Floats, rows: Floats, bound: Floats) -> None:
        """After the first refusal note all pairs that are too close at the measured poses."""
        for k, pair in np.argwhere(~(rows[1:] > bound)):
            if int(pair) not in self._bad:
                self._bad[int(pair)] = CloseGeoms(int(pair), float(times[k]), 0.0, 0.0)

    def _found(self, pieces: _CurvePieces, rows: _UnprovedPieces, place: int) -> None:
        """Find the first moment of a violation on a piece, to a thousandth of the piece."""
        pair = int(rows.pair[place])
        piece = int(rows.piece[place])
        early = float(pieces.start[piece])
        late = float(pieces.end[piece])
        time = early if not rows.first[place] > rows.bound[place] else late
        if rows.first[place] > rows.bound[place] and not rows.last[place] > rows.bound[place]:
            part = pieces.take(np.array([piece]))
            for _ in range(10):
                both = part.split()
                self._bodies.place(both.curve[-1, 0])
                clear = self._bodies.between(pair, FAR) > rows.bound[place]
                part = both.take(np.array([int(clear)]))
            time = float(part.end[0])
        known = self._bad.get(pair)
        if known is None or time < known.time:
            self._bad[pair] = CloseGeoms(pair, time, 0.0, 0.0)

    def _result(self, *, unfinished: bool) -> SweepResult:
        refused = [
            CloseGeoms(pair, close.time, float(self._least[pair]), float(self._when[pair]))
            for pair, close in self._bad.items()
        ]
        warned = [
            CloseGeoms(pair, float(since), float(self._least[pair]), float(self._when[pair]))
            for pair, since in enumerate(self._near_since)
            if since < np.inf and pair not in self._bad
        ]
        refused.sort(key=lambda close: close.time)
        warned.sort(key=lambda close: close.clearance)
        return SweepResult(tuple(refused), tuple(warned), self.work, unfinished)
