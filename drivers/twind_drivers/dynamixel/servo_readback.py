"""Reading back what was written to the servos of a bus, and reading words of them. Scripts."""

from collections.abc import Callable, Iterable, Sequence

from twind_drivers.bus import DeviceRefused, GroupWriteBatch, Script
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.servo_command_settings import Rows, ServoCommandSettings, groups, rows, writes
from twind_drivers.dynamixel.write_diagnosis import explain


class ServoReadback:
    """Readback of the servos of one bus. Every script may raise NoReply."""

    def __init__(self, reader: DynamixelReader, servos: Sequence[ServoCommandSettings]) -> None:
        self._reader = reader
        self._servos = {servo.id: servo for servo in servos}

    def words(
        self, servos: Iterable[ServoCommandSettings], where: Callable[[ServoCommandSettings], RegisterBlock]
    ) -> Script[dict[int, int]]:
        """Read one signed word of each servo; return them by id."""
        found: dict[int, int] = {}
        for block, wanted in groups(rows(servos, lambda servo: (where(servo), b""))).items():
            data = yield from self._reader.collect(tuple(wanted), block.address, block.size)
            found.update({id: int.from_bytes(raw, "little", signed=True) for id, raw in data.items()})
        return found

    def raise_cap(self, servos: Sequence[ServoCommandSettings], kind: str) -> Script[dict[int, int]]:
        """Set goal `PWM` or `current` to its limit register, read it back. Return the limits by id."""
        key = kind.lower()
        most = yield from self.words(servos, lambda servo: servo.register_span(f"{key}_limit"))
        goals = rows(
            servos,
            lambda servo: (
                servo.register_span(f"goal_{key}"),
                most[servo.id].to_bytes(2, "little", signed=True),
            ),
        )
        if goals:
            yield GroupWriteBatch(writes(goals))
        yield from self.verify(f"goal {kind}", goals)
        return most

    def verify_goals(self, wanted: Rows, verb: str = "wrote") -> Script[None]:
        """Check each kind of goal by its name. Raises DeviceRefused for the first that differs."""
        for name in dict.fromkeys(servo.mode.goal for servo in self._servos.values()):
            own = [row for row in wanted if self._servos[row[0]].mode.goal == name]
            yield from self.verify(name.replace("_", " "), own, verb)

    def verify(self, what: str, wanted: Rows, verb: str = "wrote") -> Script[None]:
        """Read each row back. Raises DeviceRefused for the first that differs, with the likely reason."""
        for where, own in groups(wanted).items():
            found = yield from self._reader.collect(tuple(own), where.address, where.size)
            for id, data in own.items():
                if found[id] != data:
                    why = yield from explain(self._reader, self._servos[id], where, data)
                    reason = f"{verb} {data.hex(' ')}, reads {found[id].hex(' ')}{why}"
                    raise DeviceRefused(self._reader.name, id, f"{what} ({where.address})", reason)
