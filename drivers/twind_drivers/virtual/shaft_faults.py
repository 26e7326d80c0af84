"""Faults of the shafts of one bus, the same for servos and CAN nodes."""

from collections.abc import Callable, Mapping, Sequence

from twind_drivers.virtual.hinge import ShaftGrip, order


class ShaftFaults:
    """Faults of shafts by id: held fast, moved by hand, reported frozen; and the pose of their base."""

    def __init__(self, unknown: str, ids: Callable[[], Sequence[int]], hands: ShaftGrip) -> None:
        """Make the faults; `ids` by row; `unknown`: begin of the error text for another id."""
        self._unknown = unknown
        self._ids = ids
        self.hands = hands

    def lock(self, id: int) -> None:
        """Lock the shaft: it does not turn, with torque or without. Raises KeyError."""
        for row in self.rows(id):
            self._block(row, True)

    def free(self, id: int) -> None:
        """Unlock the shaft. Raises KeyError."""
        for row in self.rows(id):
            self._block(row, False)

    def hand(
        self,
        id: int | None = None,
        to: float | None = None,
        rad: float | None = None,
        speed: float = 1.0,
        off: bool = False,
        pose: Mapping[str, float] | None = None,
    ) -> None:
        """Move a limp shaft by an external force straight to a position and hold it; stops limit it.

        `to`: the position that it would report, raw; `rad`: of its joint; `pose`: rad by joint, without an
        id; `speed` rad/s of the joint; `off` releases it. Where torque is on the force slips. Raises
        KeyError, ValueError.
        """
        rows = None if id is None else self.rows(id)
        order(self.hands, rows, to=to, rad=rad, speed=speed, off=off, pose=pose)

    def lay(self, base: str) -> None:
        """Hold the base of the robot in another attitude from now on. Raises KeyError, ValueError."""
        self._set_base_pose(base)

    def freeze(self, id: int, on: bool = True) -> None:
        """Repeat the reported position, wherever the shaft goes. Raises KeyError."""
        for row in self.rows(id):
            self._freeze(row, on)

    def rows(self, id: int, number: int | None = None) -> list[int]:
        """Rows of the devices with this id, or of its `number`th one, from 1.

        Raises KeyError that names the ids there are.
        """
        ids = self._ids()
        found = [row for row, each in enumerate(ids) if each == id]
        if not found:
            raise KeyError(f"{self._unknown} with id {id}; ids are {sorted(ids)}")
        if number is not None and not 0 < number <= len(found):
            raise KeyError(f"number {number}: id {id} has {len(found)}")
        return found if number is None else [found[number - 1]]

    def _block(self, row: int, held: bool) -> None:
        raise NotImplementedError

    def _freeze(self, row: int, on: bool) -> None:
        raise NotImplementedError

    def _set_base_pose(self, base: str) -> None:
        raise NotImplementedError
