"""A host on an in-process virtual bus under a fake clock: sends packets, collects statuses."""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer, Packet
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

FAST = {"baud_rate": 4, "return_delay_time": 0}


class Host:
    """`ids` servos at tick 2048 on one bus at 2 Mbaud; time moves by `wait` and while answers come."""

    def __init__(
        self,
        ids: Sequence[int] = (1, 2, 3),
        *,
        model: str | Sequence[str] = "XM430-W350",
        settings: Mapping[str, int] | None = None,
        start: float = 2048.0,
        wire_timing: bool = True,
        keep_goal: bool = True,
        firmware: int = 47,
        forgets_offset: bool = False,
        seam_seed: int | None = None,
    ) -> None:
        """`model`: of all, or one for each."""
        each = [model] * len(ids) if isinstance(model, str) else model
        specs = [
            ServoSpec(id, name, FAST | dict(settings or {}), firmware, forgets_offset, seam_seed)
            for id, name in zip(ids, each, strict=True)
        ]
        self.muscles = FirstOrderPhysics(np.full(len(ids), start))
        self.bus = VirtualBus("test", specs, self.muscles, wire_timing=wire_timing, keep_goal=keep_goal)
        self.clock = FakeClock()
        self.servos = self.bus.servos

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock.now() + seconds)
        self.bus.advance(self.clock.now())

    def raw(self, request: bytes) -> bytes:
        """Everything that comes back, waited for."""
        self.bus.receive(request, self.clock.now())
        answer = b""
        while (due := self.bus.next_output_time()) < np.inf:
            self.clock.sleep_until(due)
            answer += self.bus.take(self.clock.now())
        return answer

    def ask(self, request: bytes) -> list[Packet]:
        return Framer(status=True).feed(self.raw(request))

    def read(self, id: int, address: int, size: int, *, signed: bool = True) -> int:
        (answer,) = self.ask(packet.read(id, address, size))
        assert answer.error & 0x7F == 0, answer
        return int.from_bytes(answer.data, "little", signed=signed)

    def write(self, id: int, address: int, value: int, size: int) -> int:
        """The error byte of the status."""
        data = value.to_bytes(size, "little", signed=value < 0)
        (answer,) = self.ask(packet.write(id, address, data))
        return answer.error

    def keep_readings(self) -> None:
        """From now on the present registers keep what a test puts there."""
        self.servos.settle = lambda now, **rest: None  # type: ignore[method-assign]

    def torque(self, id: int, on: bool = True) -> None:
        assert self.write(id, 64, int(on), 1) == 0

    def goal(self, id: int, ticks: int) -> int:
        return self.write(id, 116, ticks, 4)

    def present(self, id: int) -> int:
        return self.read(id, 132, 4)
