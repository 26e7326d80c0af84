"""Actuators of one bus, of any number of families, behind one set of arrays. Pure.

Rows are indices on the bus, in the order of the ids; a family has its own rows among them. Decoded frames are
untrusted and sorted here: feedback, register replies, orders of another master, unknown devices.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Bools, Floats, Ints
from twind_drivers.can.actuator import CanActuatorIdentity, place_of
from twind_drivers.can.actuator_family import (
    ActuatorFamily,
    ActuatorFeedback,
    FamilyRegister,
    FieldRanges,
    RegisterReply,
    ValuelessCommand,
)
from twind_drivers.ports.frame import EXTENDED, FRAME, NOTHING, Frames

T = TypeVar("T", bound=np.generic)
_RAW = np.dtype((np.void, FRAME.itemsize))


@dataclass(slots=True)
class GroupFeedback:
    """Feedback in a batch of frames: the newest of each actuator.

    Arrays (m,), SI; NaN or -1: not reported.
    """

    count: Ints  # frames of feedback
    position: Floats
    velocity: Floats
    effort: Floats
    temperature: Floats
    voltage: Floats
    enabled: Ints
    fault: Ints
    answers: list[RegisterReply] = field(default_factory=list)  # registers, rows of the bus
    masters: int = 0  # frames that command an actuator of this bus: another master's
    strangers: int = 0  # frames of no device on this bus

    @classmethod
    def nothing(cls, m: int) -> "GroupFeedback":
        """Return the feedback of m silent actuators: no frames, all values unknown."""
        return cls(
            np.zeros(m, np.int64),
            np.full(m, np.nan),
            np.full(m, np.nan),
            np.full(m, np.nan),
            np.full(m, np.nan),
            np.full(m, np.nan),
            np.full(m, -1, np.int64),
            np.full(m, -1, np.int64),
        )


class ActuatorGroup:
    """Families of one bus. Ids are distinct over all of them."""

    def __init__(
        self,
        name: str,
        actuators: Sequence[CanActuatorIdentity],
        families: Sequence[tuple[ActuatorFamily, Sequence[int]]],
    ) -> None:
        """Make the group; `families`: each with the rows of its actuators, in the order of its ids.

        Raises ValueError for no actuators, for ids given twice, and for rows that do not occur exactly once.
        """
        self.name = name
        self.actuators = tuple(actuators)
        self.ids = tuple(each.id for each in actuators)
        if not self.ids or len(set(self.ids)) != len(self.ids):
            raise ValueError(f"{name}: distinct ids are needed, got {list(self.ids)}")
        if sorted(row for _, rows in families for row in rows) != list(range(len(self.ids))):
            raise ValueError(f"{name}: each actuator belongs to one family, once")
        self.families = tuple((family, np.array(rows, np.int64)) for family, rows in families)
        self._of: dict[int, tuple[ActuatorFamily, int]] = {
            row: (family, place) for family, rows in families for place, row in enumerate(rows)
        }
        # All of one family, in its order: its arrays are the bus's.
        self._alone = self.families[0][0] if len(self.families) == 1 else None
        self.wide = any(
            self.encode_valueless_command(row, ValuelessCommand.DISABLE)["id"][0] & EXTENDED
            for row in self._of
        )
        self.ranges = self._ranges()
        self._silence = GroupFeedback.nothing(len(self.ids))
        self._rows = list(range(len(self.ids)))
        self._once = np.ones(len(self.ids), np.int64)
        self._once.setflags(write=False)
        self.replies = self._scatter_to_rows(lambda family: family.replies, np.bool_)
        self.answers = self._scatter_to_rows(lambda family: family.answers, np.int64)

    def __len__(self) -> int:
        return len(self.ids)

    def _scatter_to_rows(self, of: Callable[[ActuatorFamily], Any], kind: type[T]) -> NDArray[T]:
        whole = np.zeros(len(self.ids), kind)
        for family, rows in self.families:
            whole[rows] = of(family)
        return whole

    def family_of_row(self, row: int) -> tuple[ActuatorFamily, int]:
        """Return the family of a row, and its index in that family."""
        return self._of[row]

    def row(self, id: int) -> int:
        """Return the row of an id. Raises KeyError that lists the ids of this bus."""
        return place_of(self.name, self.ids, id)

    def learn(self, row: int, values: Mapping[str, float]) -> None:
        """Take the identification values of one actuator; ranges that it reports enter `ranges` (m,)."""
        family, place = self._of[row]
        family.learn(place, values)
        self.ranges = self._ranges()

    def _ranges(self) -> FieldRanges:
        return FieldRanges(
            position=self._scatter_to_rows(lambda family: family.ranges.position, np.float64),
            velocity=self._scatter_to_rows(lambda family: family.ranges.velocity, np.float64),
            torque=self._scatter_to_rows(lambda family: family.ranges.torque, np.float64),
            kp=self._scatter_to_rows(lambda family: family.ranges.kp, np.float64),
            kd=self._scatter_to_rows(lambda family: family.ranges.kd, np.float64),
        )

    # --------------------------------------------------------------------------- out

    def make_position_request(self, rows: Bools | None = None) -> tuple[Frames, Ints]:
        """Return frames that request the position of `rows` (m,), None: all.

        Also returns the number of frames that each of the m actuators answers with.
        """
        requested = [
            (family, own)
            for family, own in self.families
            if family.answers and (rows is None or rows[own].any())
        ]
        expect = np.zeros(len(self.ids), np.int64)
        for family, own in requested:
            expect[own] = family.answers
        return joined([family.make_position_request() for family, _ in requested]), expect

    def command(self, values: Floats, rows: Bools | None = None) -> Frames:
        """Encode commands of `values` (5, m): position, velocity, kp, kd, torque; `rows` (m,): these alone.

        Raises WireRangeError for a value outside its field.
        """
        if self._alone is not None:
            made = self._alone.command(*values)
        else:
            made = joined([family.command(*values[:, own]) for family, own in self.families])
        return made if rows is None else self._only(made, rows)

    def gains(self, kp: Floats, kd: Floats, rows: Bools | None = None) -> Frames:
        """Frames needed beside the commands (m,): see `ActuatorFamily.gains`. Raises WireRangeError."""
        if rows is not None:  # of the others no value is sent, but it must be one of their field
            kp = np.where(rows, kp, self.ranges.kp)
            kd = np.where(rows, kd, self.ranges.kd)
        made = joined([family.gains(kp[own], kd[own]) for family, own in self.families])
        return made if rows is None else self._only(made, rows)

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """Encode one order. Raises ValueError if its family lacks it."""
        family, place = self._of[row]
        return family.encode_valueless_command(place, what)

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Encode the read of one register. Raises ValueError if its family cannot."""
        family, place = self._of[row]
        return family.read(place, parameter)

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Encode the write of one register. Raises ValueError if its family cannot."""
        family, place = self._of[row]
        return family.write(place, parameter, data)

    def _only(self, made: Frames, rows: Bools) -> Frames:
        to = self.commanded_rows(made)
        chosen: Frames = made[(to >= 0) & rows[to]]
        return chosen

    # --------------------------------------------------------------------------- the last check

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row (k,) that each frame commands, enables or writes; -1: none."""
        if self._alone is not None:
            return self._alone.commanded_rows(frames)
        to = np.full(len(frames), -1, np.int64)
        for family, own in self.families:
            place = family.commanded_rows(frames)
            mine = place >= 0
            to[mine] = own[place[mine]]
        return to

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position (k,) in rad that each frame commands; NaN: none."""
        if self._alone is not None:
            return self._alone.decode_commanded_position(frames)
        place = np.full(len(frames), np.nan)
        for family, _ in self.families:
            own = family.decode_commanded_position(frames)
            place[~np.isnan(own)] = own[~np.isnan(own)]
        return place

    # --------------------------------------------------------------------------- in

    def decode_frames(self, frames: Frames) -> GroupFeedback:
        """Decode received frames, the newest of each actuator; nothing raises."""
        if not len(frames):
            return self._silence
        if self._alone is not None and len(frames) == len(self.ids):
            usual = self._usual(self._alone, frames)
            if usual is not None:
                return usual
        feedback = GroupFeedback.nothing(len(self.ids))
        known = np.zeros(len(frames), np.bool_)
        for family, own in self.families:
            reported, mine = family.feedback(frames)
            answers, answered = family.decode_register_replies(frames)
            known |= mine | answered
            _keep(feedback, reported, own)
            feedback.answers += [each._replace(row=int(own[each.row])) for each in answers]
        if not known.all():
            rest = frames[~known]
            feedback.masters = int(np.count_nonzero(self.commanded_rows(rest) >= 0))
            feedback.strangers = len(rest) - feedback.masters
        return feedback

    def _usual(self, family: ActuatorFamily, frames: Frames) -> GroupFeedback | None:
        """Decode the healthy case, one frame of feedback of each, in any order; return None for any other."""
        reported, _ = family.feedback(frames)
        rows = reported.rows.tolist()
        if rows != self._rows:  # not in the order of the requests
            if len(rows) != len(self.ids) or len(set(rows)) != len(rows):
                return None
            reported = _ordered(reported)
        return GroupFeedback(
            self._once,
            reported.position,
            reported.velocity,
            reported.effort,
            reported.temperature,
            reported.voltage,
            reported.enabled,
            reported.fault,
        )


def _ordered(feedback: ActuatorFeedback) -> ActuatorFeedback:
    """Return the feedback in order of the rows."""
    order = feedback.rows.argsort()
    return ActuatorFeedback(
        feedback.rows[order],
        feedback.position[order],
        feedback.velocity[order],
        feedback.effort[order],
        feedback.enabled[order],
        feedback.fault[order],
        feedback.temperature[order],
        feedback.voltage[order],
    )


def joined(parts: Sequence[Frames]) -> Frames:
    """Concatenate frames in this order."""
    full = [part for part in parts if len(part)]
    if len(full) > 1:  # as plain bytes: numpy takes its time over the fields of a record
        whole: Frames = np.concatenate([part.view(_RAW) for part in full]).view(FRAME)
        return whole
    return full[0] if full else NOTHING


def _keep(feedback: GroupFeedback, reported: ActuatorFeedback, own: Ints) -> None:
    rows = own[reported.rows]
    np.add.at(feedback.count, rows, 1)
    for name in ("position", "velocity", "effort", "temperature", "voltage"):
        values = getattr(reported, name)
        known = ~np.isnan(values)
        getattr(feedback, name)[rows[known]] = values[known]  # of several frames the last is the newest
    for name in ("enabled", "fault"):
        values = getattr(reported, name)
        known = values >= 0
        getattr(feedback, name)[rows[known]] = values[known]
