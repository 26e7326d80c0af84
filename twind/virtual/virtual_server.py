"""Server loop of `twind-virtual`: one thread for all pseudo-terminals, physics, faults.

It runs in the servos' own time: the monotonic clock, which stands still while this process is stopped or not
scheduled. So a busy machine does not trip watchdogs that no host has missed. The clock register of the
servos (120) runs on meanwhile: a host would take a stopped one for a restart.
"""

import os
import select
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from twind.config.driver_family import family
from twind.config.port_names import Medium
from twind.exceptions import InvalidInput
from twind.twin.base_support import BaseSupport
from twind.virtual.fault_commands import BODY_FAULTS, SHARED_FAULTS, FaultCommandSocket, Order, arguments
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.virtual_power import POWER_FAULTS, VirtualPower
from twind.virtual.virtual_twin import twin_of
from twind_drivers.clock import Clock
from twind_drivers.virtual.servable_bus import ServableBus
from twind_drivers.virtual.virtual_sensor import VirtualSensor

STEP = 0.002  # s between two steps of physics and watchdogs, with or without traffic
STALL = 0.02  # s: a longer gap between two rounds did not happen to the servos
PAGE = 500  # readings in one answer: 24 servos fit into what a socket takes at once
BUSY = 0.00008  # s of busy waiting before a servo's answer is due: a timer is that late


class ServoClock:
    """Clock of the servos. It advances by at most `STALL` at once, so that catching up is bounded."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last = clock.now()
        self._lost = 0.0

    @property
    def skipped_time(self) -> float:
        """Time that this clock left out, s."""
        return self._lost

    def now(self) -> float:
        """Time of the servos, s."""
        real = self._clock.now()
        self._lost += max(0.0, real - self._last - STALL)
        self._last = real
        return real - self._lost


class VirtualBusServer:
    """Server of buses behind ports. `on_plugged` is called when a port is plugged in: bus name, path.

    `support`: support of the base of a body that stands freely.
    """

    def __init__(
        self,
        buses: Mapping[str, ServableBus],
        ports: Mapping[str, VirtualPtyPort],
        clock: ServoClock,
        on_plugged: Callable[[str, str], None],
        support: BaseSupport | None = None,
    ) -> None:
        self._pairs = [(buses[name], port) for name, port in ports.items()]
        self._buses = buses
        self._batched = {bus.name for bus in buses.values() if family(bus.kind).medium is Medium.CAN}
        self._ports = ports
        self._clock = clock
        self._on_plugged = on_plugged
        self._support = support
        self.power: VirtualPower | None = None  # None: neither relay nor button
        self._lost = clock.skipped_time  # s, that the clock registers have counted
        self.input = -1  # descriptor of a pipe whose end ends the server; -1: none
        self.ended = False
        self.orders: FaultCommandSocket | None = None

    def run(self) -> None:
        """Serve until `ended`."""
        next_step = self._clock.now()
        while not self.ended:
            ready = self._wait(next_step)
            now = self._clock.now()
            self.count_skipped_time()
            for bus, port in self._pairs:
                if port.fd in ready and not bus.faults.stalled and (data := port.read()):
                    bus.line(port.baud())
                    bus.receive(data, now)
            if now >= next_step:
                next_step = now + STEP
                for bus, port in self._pairs:
                    bus.advance(now)
                    port.look()
                if self.power is not None:
                    self.power.serve()
            for bus, port in self._pairs:
                if bus.next_output_time() <= now:
                    port.write(bus.take(now))
            if self.orders is not None and not ready.isdisjoint(self.orders.filenos()):
                self.orders.serve()

    def switch_supply(self, on: bool) -> None:
        """Switch the supply of all devices."""
        now = self._clock.now()
        for bus in self._buses.values():
            bus.advance(now)
            bus.faults.power(on)

    def count_skipped_time(self) -> None:
        """Add the time that the clock left out to the clock registers of the servos."""
        more = self._clock.skipped_time - self._lost
        if more > 0.0:
            self._lost += more
            for bus in self._buses.values():
                bus.skip_time(more)

    def _wait(self, next_step: float) -> set[int]:
        """Wait until work is due; return the descriptors with data."""
        late = next_step  # s; what comes in batches of an adapter may come as late as a timer is
        soon = np.inf
        for bus, _ in self._pairs:
            if bus.name in self._batched:
                late = min(late, bus.next_output_time())
            else:
                soon = min(soon, bus.next_output_time())
        left = min(soon - BUSY, late) - self._clock.now()
        sources = [port.fd for bus, port in self._pairs if port.present and not bus.faults.stalled]
        if self.input >= 0:
            sources.append(self.input)
        if self.orders is not None:
            sources += self.orders.filenos()
        if self.power is not None:
            sources += self.power.filenos()
        ready, _, _ = select.select(sources, [], [], max(left, 0.0))
        if self.input in ready and not os.read(self.input, 4096):
            self.ended = True
        return set(ready)

    # --------------------------------------------------------------------------------- faults

    def execute_fault_command(self, order: Order) -> Order:
        """Execute one order of the faults socket. Raises InvalidInput, KeyError, ValueError."""
        if order.get("query") == "state":
            return self._state()
        if order.get("query") == "history":
            return self._history(order)
        if "query" in order:
            raise InvalidInput(f"no query {order['query']!r}; there are state, history")
        if order.get("fault") == "hand" and "bus" not in order and len(self._pairs) > 1:
            return self._hands(order)
        if order.get("fault") in BODY_FAULTS:
            return self._body(order)
        if self.power is not None and order.get("fault") in POWER_FAULTS:
            name, given = arguments(order, POWER_FAULTS)
            getattr(self.power, name)(**given)
            return {"ok": True}
        bus, port = self._chosen(order.get("bus"))
        name, given = arguments(order, twin_of(family(bus.kind)).faults)
        bus.advance(self._clock.now())
        getattr(bus.faults, name)(**given)
        if name == "unplug":
            port.unplug()
        elif name == "replug":
            port.plug(renamed=given.get("renamed", False))
            self._on_plugged(port.name, port.path)
        return {"ok": True, "bus": port.name, "path": port.path}

    def _hands(self, order: Order) -> Order:
        """Apply hand positions to all buses: a pose is split among them, `off` without an id is for all."""
        _, given = arguments(order, SHARED_FAULTS)
        pose = given.pop("pose", {})
        if "id" in given or not (pose or given.get("off")):
            self._chosen(None)  # raises with the names of the buses
        known = {name: bus for bus, _ in self._pairs for name in bus.faults.hands.joints}
        strange = [name for name in pose if name not in known]
        if strange:
            raise InvalidInput(f"hand: no joint {strange[0]!r}; there are {', '.join(sorted(known))}")
        for bus, _ in self._pairs:
            own = {name: rad for name, rad in pose.items() if known[name] is bus}
            bus.advance(self._clock.now())
            if own or not pose:
                bus.faults.hand(**given, **({"pose": own} if own else {}))
        return {"ok": True}

    def _body(self, order: Order) -> Order:
        """Apply an order that acts on the whole body and belongs to no bus. Raises InvalidInput."""
        name, given = arguments(order, BODY_FAULTS)
        for bus, _ in self._pairs:
            bus.advance(self._clock.now())
        if name == "imu":
            self._sensor().err(**given)
        elif self._support is None:
            raise InvalidInput(f"{name}: no body stands here freely: `support: free`, upright, with MuJoCo")
        else:
            getattr(self._support, name)(**given)
        return {"ok": True}

    def _sensor(self) -> VirtualSensor:
        """Return the inertial sensor of the robot. Raises InvalidInput: it has none."""
        found = [bus.sensor for bus, _ in self._pairs if bus.sensor is not None]
        if not found:
            raise InvalidInput("imu: this robot has none: `sensors` in its robot file")
        return found[0]

    def _chosen(self, name: Any) -> tuple[ServableBus, VirtualPtyPort]:
        if name is None and len(self._pairs) == 1:
            return self._pairs[0]
        if not isinstance(name, str) or name not in self._buses:
            raise InvalidInput(f"no bus {name!r}; there are {', '.join(self._buses)}")
        return self._buses[name], self._ports[name]

    def _state(self) -> Order:
        now = self._clock.now()
        buses = {}
        for name, bus in self._buses.items():
            buses[name] = {"plugged": bus.is_plugged, "kind": bus.kind, "servos": bus.truth(now)}
        body = {} if self._support is None else {"body": self._support.truth()}
        power = {} if self.power is None else {"power": self.power.truth()}
        return {"ok": True, "now": now, "lost": self._clock.skipped_time, "buses": buses, **body, **power}

    def _history(self, order: Order) -> Order:
        """Return at most `PAGE` readings, the oldest first, of those after `since` (s)."""
        bus, port = self._chosen(order.get("bus"))
        since = order.get("since", -1.0)
        if not isinstance(since, int | float) or isinstance(since, bool):
            raise InvalidInput(f"history: since is {since!r}; it is a time in s")
        if bus.history is None:
            raise InvalidInput(
                f'bus {port.name}: nothing is recorded; order {{"fault": "record", "count": 1000}}'
            )
        times, positions = bus.history.readings()
        first = int(np.searchsorted(times, since, side="right"))
        return {
            "ok": True,
            "bus": port.name,
            "now": self._clock.now(),
            "ids": bus.ids(),
            "more": first + PAGE < len(times),
            "time": times[first : first + PAGE].tolist(),
            "position": positions[first : first + PAGE].tolist(),
        }
