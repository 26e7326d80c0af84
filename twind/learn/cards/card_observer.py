"""Observation of a carded policy: entries that are picked from what the robot has, scaled, with history.

`ObservationBuilder` gives the values, as for a policy of `twindctl train`; each input of the network is a
selection of them.
"""

from math import asin, atan2, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twind.exceptions import InvalidInput
from twind.learn.cards.interface_card import InputSpec, InterfaceCard, TermSpec
from twind.learn.cards.observation_terms import KNOWN
from twind.learn.task.observation import BodyReading, ObservationBuilder, Observations
from twind.learn.task.observation_layout import ObservationLayout
from twind.robot.arrays import Floats

CONTACT = 0.01  # m above the lower sole below which a foot counts as standing
AGES = 3  # last actions that are kept
MOST = 1 << 20  # entries of an input
STILL = 0.01  # size of a command below which it is zero
UNBOUNDED = np.array([-np.inf, np.inf])


class _TermEntries(NamedTuple):
    """Entries of one term: clip(values[place] * sign + shift, low, high) * scale, (m,) each."""

    label: str
    place: NDArray[np.int64]
    sign: Floats
    shift: Floats
    clip: Floats  # (2, m)
    scale: Floats


class CardObserver:
    """Observations of one robot, by name of the input. Keeps histories, actions, phase and yaw."""

    def __init__(self, card: InterfaceCard, joints: tuple[str, ...], default: Floats) -> None:
        """`joints`: of the robot, in its order; `default`: (n,), rad. Raises InvalidInput."""
        self._layout = ObservationLayout(joints)
        self._builder = ObservationBuilder(self._layout, default)
        self._none = np.zeros(len(joints))
        self._still = np.zeros(4)
        self._card = card
        self._actions = np.zeros((AGES, len(card.joints)))
        self._yaw = 0.0
        self._places = self._blocks(len(joints))
        self.inputs = {
            name: _CardInput(name, spec, [self._entries(*each, default) for each in spec.terms.items()])
            for name, spec in card.inputs.items()
        }

    def begin(self, action: Floats | None = None) -> None:
        """Forget every step; `action` (m,) then counts as the last ones."""
        self._yaw = 0.0
        self._actions[:] = 0.0 if action is None else action
        for each in self.inputs.values():
            each.begin()

    def record(self, action: Floats) -> None:
        """Keep the action (m,) that was sent."""
        self._actions = np.concatenate([action[None], self._actions[:-1]])

    def observe(
        self, reading: BodyReading, target: Floats, command: Floats, step: int
    ) -> dict[str, Observations] | str:
        """Return one new array per input; a text: the entry that is not finite."""
        own = self._builder.observe(reading, self._none, target, command, self._still)
        parts = (own, target, self._attitude(reading), _contacts(reading), self._actions.ravel())
        values = np.concatenate([*parts, self._phases(command, step), [1.0]])
        found = {}
        for name, each in self.inputs.items():
            frame = each.frame(values)
            finite = np.isfinite(frame)
            if not finite.all():
                return f"entry {each.label(int(np.argmin(finite)))} of the observation is not finite"
            found[name] = each.push(frame)
        return found

    def _attitude(self, reading: BodyReading) -> Floats:
        """Quaternion w x y z and roll, pitch, yaw (7,). Yaw is integrated, so it drifts."""
        x, y, z = reading.gravity.tolist()
        roll = atan2(-y, -z)
        pitch = asin(min(max(x, -1.0), 1.0)) if x == x else x
        half = 0.5 * np.array([roll, pitch, self._yaw])
        (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
        turn = np.array(
            [
                cr * cp * cy + sr * sp * sy,
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
            ]
        )
        found = np.concatenate([turn if not turn[0] < 0.0 else -turn, 2.0 * half])
        self._yaw -= float(reading.gyro @ reading.gravity) * self._card.period
        self._yaw = (self._yaw + pi) % (2.0 * pi) - pi
        return found

    def _phases(self, command: Floats, step: int) -> Floats:
        """Sines, then cosines of the phases (2k,)."""
        spec = self._card.phase
        if spec is None:
            return np.zeros(0)
        phase = np.array(spec.offsets_rad) + 2.0 * pi * step * self._card.period / spec.period_s
        if spec.still_rad is not None and float(np.linalg.norm(command)) < STILL:
            phase = np.full(len(phase), spec.still_rad)
        return np.concatenate([np.sin(phase), np.cos(phase)])

    def _blocks(self, count: int) -> dict[str, slice]:
        """Place of every block of values, by name."""
        phases = 0 if self._card.phase is None else len(self._card.phase.offsets_rad)
        sizes = {"target": count, "orientation": 4, "roll_pitch_yaw": 3, "foot_contact": 2}
        sizes |= {"actions": self._actions.size, "phase_sin": phases, "phase_cos": phases, "one": 1}
        places = dict(self._layout.places)
        end = self._layout.size
        for name, size in sizes.items():
            places[name] = slice(end, end + size)
            end += size
        return places

    def _entries(self, label: str, term: TermSpec, default: Floats) -> _TermEntries:
        """Resolve one term. Raises InvalidInput."""
        name = term.term or label
        known = KNOWN[name]
        place = self._places[known.block]
        index = np.arange(place.start, place.stop)
        names = self._card.joints if term.joints is None else term.joints
        sign = np.ones(len(index))
        shift = np.zeros(len(index))
        if known.each == "joint":
            order = [self._layout.joints.index(each) for each in names]
            index = index[order]
            sign = np.array([float(self._card.signs.get(each, 1)) for each in names])
            shift = sign * default[order] * (name == "joint_position" and term.reference == "zero")
        elif known.each == "action":
            index = index.reshape(AGES, -1)[term.age - 1]
            sign = np.ones(len(index))
            shift = np.zeros(len(index))
        elif name == "constant":
            index = np.repeat(index, term.size)
            sign = np.full(term.size, term.value)
            shift = np.zeros(term.size)
        if term.entries is not None:
            if max(term.entries, default=0) >= len(index):
                raise InvalidInput(
                    f"its card: term {label} has {len(index)} entries, {max(term.entries)} is none"
                )
            picked = list(term.entries)
            index = index[picked]
            sign = sign[picked]
            shift = shift[picked]
        scales = np.full(len(index), term.scale) if term.scales is None else np.array(term.scales)
        if len(scales) != len(index):
            raise InvalidInput(f"its card: term {label} has {len(index)} entries and {len(scales)} scales")
        bounds = UNBOUNDED if term.clip is None else np.array(term.clip)
        clip = np.repeat(bounds[:, None], len(index), axis=1)
        return _TermEntries(label, index, sign, shift + term.offset, clip, scales)


class _CardInput:
    """One input of the network: its frame, and the last frames."""

    def __init__(self, name: str, spec: InputSpec, terms: list[_TermEntries]) -> None:
        self._spec = spec
        self._labels = [f"{term.label}[{at}]" for term in terms for at in range(len(term.place))]
        self._place, self._sign, self._shift, self._scale = (
            np.concatenate([getattr(term, key) for term in terms])
            for key in ("place", "sign", "shift", "scale")
        )
        self._low, self._high = np.concatenate([term.clip for term in terms], axis=1)
        if spec.history * len(self._place) > MOST:
            raise InvalidInput(f"its card: input {name} has more than {MOST} entries")
        self._frames = np.zeros((spec.history, len(self._place)), np.float32)  # the newest last
        self._empty = True
        self._order = self._stacked([len(term.place) for term in terms], list(spec.terms.values()))
        steps, size = self._frames.shape
        shapes = {"flat": (1, len(self._order)), "steps": (1, steps, size), "channels": (1, size, steps)}
        self.shape: tuple[int, ...] = shapes[spec.shape]

    def begin(self) -> None:
        """Forget the frames."""
        self._frames[:] = 0.0
        self._empty = True

    def label(self, entry: int) -> str:
        """Name of an entry of a frame, such as `joint_velocity[3]`."""
        return self._labels[entry]

    def frame(self, values: Floats) -> Observations:
        """Return the entries of now (size,): infinite where the network's float32 cannot hold them."""
        raw = values[self._place] * self._sign + self._shift
        found = np.minimum(np.maximum(raw, self._low), self._high) * self._scale
        low, high = UNBOUNDED if self._spec.clip is None else self._spec.clip
        with np.errstate(over="ignore"):
            kept: Observations = np.clip(found, low, high).astype(np.float32)
        return kept

    def push(self, frame: Observations) -> Observations:
        """Add a frame; return the array for the network, in `shape`."""
        self._frames[:-1] = frame if self._empty and self._spec.fill == "first" else self._frames[1:].copy()
        self._frames[-1] = frame
        self._empty = False
        stacked = self._frames.ravel()[self._order]
        if self._spec.shape == "channels":
            return stacked.reshape(self._frames.shape).T[None].copy()
        return stacked.reshape(self.shape)

    def _stacked(self, sizes: list[int], terms: list[TermSpec]) -> NDArray[np.int64]:
        """Order of the entries of all frames, the newest last, in the array."""
        steps = len(self._frames)
        places = np.arange(self._frames.size).reshape(self._frames.shape)
        onwards = slice(None) if self._spec.newest == "last" else slice(None, None, -1)
        if self._spec.stacking == "step":
            return places[onwards].ravel()
        ends = np.cumsum(sizes).tolist()
        rows = []
        for end, size, term in zip(ends, sizes, terms, strict=True):
            own = places[steps - (term.history or steps) :, end - size : end]
            rows.append(own[onwards].ravel())
        return np.concatenate(rows)


def _contacts(reading: BodyReading) -> Floats:
    """1 for the left and the right foot that is as low as the lower one, else 0."""
    depth = reading.soles @ reading.gravity
    return np.where(depth.max() - depth < CONTACT, 1.0, 0.0)
