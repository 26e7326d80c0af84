"""Common part of all virtual CAN actuators: power, faults, and the interface of a family.

A node receives only while it has power and its connector is plugged in; the bus enforces that.
"""

import math
from collections.abc import Sequence
from math import inf

from twind_drivers.can.can_units import COUNT, EFFORT
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node_shaft import NodeShaft, NodeWatchdog
from twind_drivers.virtual.can.node_spec import NodeSpec

BOOT = 0.3  # s from power to the first frame (assumed)
# V, °C
NOMINAL = 48.0
AMBIENT = 25.0
HEAT = "heat"
LOW = "low"
HIGH = "high"
COMMON = ("hottest", "lowest", "highest", "boot")  # settings that are no register


class VirtualCanNode:
    """One actuator. Times are s of the bus; the class of a family defines the meaning of its frames."""

    def __init__(self, spec: NodeSpec, row: int, motors: CanMotors, now: float) -> None:
        self.spec = spec
        self.row = row
        self.id = spec.id
        self.motors = motors
        self.shaft = NodeShaft(row, motors)
        self.watch = NodeWatchdog(now)
        self.spans = (spec.position, spec.velocity, spec.torque)
        self.powered = True
        self.boots_at = inf
        self.silenced = False  # its connector is pulled
        self.fault = 0  # in the vendor's own code
        self.celsius = AMBIENT
        self.volts = NOMINAL

    # ------------------------------------------------------------------------------- interface of a family

    def handle_frame(self, message: CanMessage, now: float) -> Sequence[CanMessage]:
        """Return the answers to a frame, after its effect. Frames for other nodes give nothing."""
        raise NotImplementedError

    def accepts_id(self, key: int) -> bool:
        """True if frames with this id (11 bits), or with these 8 lowest bits of 29, may be for this node."""
        return key == self.id

    def encode_fault(self, what: str) -> int:
        """Return the family's own code for heat, low or high voltage."""
        raise NotImplementedError

    def start(self) -> None:
        """Reset after power-on: values that are not stored are as from the factory."""

    def next_beat(self) -> float:
        """Return the time (s) of the next frame that it sends without a request; `inf`: never."""
        return inf

    def beat(self, now: float) -> Sequence[CanMessage]:
        """Return the frames that it sends without a request, when `next_beat` has come."""
        return ()

    def on_watchdog_timeout(self, now: float) -> Sequence[CanMessage]:
        """Handle an expired watchdog: torque off. A family adds the frames that report it."""
        self.watch.trip(now)
        self.shaft.disable()
        return ()

    def watchdog(self) -> int:
        """Return the watchdog register; 0: off, -1: not readable over the bus."""
        return -1

    def bounds(self) -> tuple[float, float, float]:
        """Return the highest °C and the lowest and highest V that it withstands."""
        own = self.spec.settings
        return own.get("hottest", 100.0), own.get("lowest", 15.0), own.get("highest", 60.0)

    # ------------------------------------------------------------------------------- power and faults

    def enable(self) -> None:
        """Switch torque on, where no fault forbids it."""
        if not self.fault and not self.shaft.on:
            self.shaft.enable()
            self.watch.tripped = False

    def inject_fault(self, bits: int) -> Sequence[CanMessage]:
        """Set a fault in the vendor's code: torque off until cleared. Return the frames that report it."""
        self.fault |= bits
        self.shaft.disable()
        return ()

    def clear(self) -> None:
        """Clear the fault; one whose cause persists comes back at once."""
        self.fault = 0
        self.watch.tripped = False
        self.suffer()

    def suffer(self) -> None:
        """Check temperature and supply against `bounds`."""
        hottest, lowest, highest = self.bounds()
        found = {HEAT: self.celsius >= hottest, LOW: self.volts < lowest, HIGH: self.volts > highest}
        for what, ails in found.items():
            if ails:
                self.inject_fault(self.encode_fault(what))

    def down(self, until: float) -> None:
        """Remove power, or restart: back at `until` (s; inf: only by a later order)."""
        self.shaft.disable()
        self.powered = False
        self.boots_at = until

    def boot(self, now: float) -> None:
        """Boot: torque off, no fault, position within one turn around its zero."""
        self.powered = True
        self.boots_at = inf
        self.fault = 0
        self.watch.tripped = False
        self.watch.heard_at = now
        if self.spec.forgets_zero:
            self.shaft.kept_zero = 0.0
        self.shaft.wrap_position()
        self.start()
        self.suffer()

    def truth(self, now: float) -> dict[str, object]:
        """Return the true state of the node, independent of the bus; raw units of `can_units`.

        The keys are those of a serial servo.
        """
        motors = self.motors
        row = self.row
        shaft = self.shaft
        watch = self.watch
        return {
            "id": self.id,
            "family": self.spec.spoken(),
            "position": shaft.read_state()[0] / COUNT,
            "encoder": float(motors.muscles.position[row]) / COUNT,
            "velocity": motors.velocity[row] / COUNT,
            "effort": motors.torque[row] / EFFORT,
            "goal": shaft.goal / COUNT,
            "torque": shaft.on,
            "fault": self.fault,
            "watchdog": self.watchdog(),
            "tripped": watch.tripped,
            "listening": self.powered and not self.silenced,
            "heard_ago": now - watch.heard_at,
            "tripped_at": None if math.isnan(watch.tripped_at) else watch.tripped_at,
            "trip_delay": None if math.isnan(watch.trip_delay) else watch.trip_delay,
        }
