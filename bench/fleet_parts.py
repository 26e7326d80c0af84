"""Processes of the fleet figures: a router, hundreds of robots, and a listener. `bench/fleet.py` runs them.

Each process answers a line of JSON on standard input with one on standard output, and ends when its input
ends. `time` is the monotonic clock, which all processes of a machine share.
"""

import json
import os
import struct
import sys
import time
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from twind.bridge.zenoh.zenoh_keys import ROOT, robot_key
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now

Asked = Mapping[str, Any]
STAMP = struct.Struct("<d")  # s: when the message was handed to Zenoh
PATIENCE = 10.0  # s to connect
SLOT = 0.0005  # s: robots that are due within it send together


def name(number: int) -> str:
    """Return the name of robot `number`: `robot-0001`."""
    return f"robot-{number:04}"


def opened(endpoint: str) -> zenoh.Session:
    """Open a session to the router at this endpoint."""
    return open_now(NetworkConfig(connect=(endpoint,)), PATIENCE)


class FleetRouter:
    """Router that forwards the messages of the other processes."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        settings = {
            "mode": "router",
            "listen/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,  # with it the router takes 351 sessions and no more
            "transport/unicast/max_sessions": 10_000,  # of itself 1000
            "transport/link/tx/queue/size/data": 16,  # batches that wait for a busy listener; of itself 2
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self._session = zenoh.open(config)

    def answer(self, asked: Asked) -> Asked:
        """Return an empty answer: the router takes no commands."""
        return {}


class SimulatedRobots:
    """`count` robots numbered from `first` on, each with its own session, as on separate machines.

    They declare themselves alive, and send `payload` on command: robot i at i/count of the period.
    """

    def __init__(self, endpoint: str, first: int, count: int, payload: bytes) -> None:
        self._payload = payload
        self._names = [name(first + place) for place in range(count)]
        self._sessions = [opened(endpoint) for _ in self._names]
        pairs = zip(self._sessions, self._names, strict=True)
        self._puts: list[Any] = []
        self._alive = [
            session.liveliness().declare_token(robot_key(robot, "alive")) for session, robot in pairs
        ]

    def answer(self, asked: Asked) -> Asked:
        """Execute one command: `key` sets the key that the robots send on, `rate` sends messages.

        `rate`: messages per second of each robot, for `seconds`, from the time `start` on. Returns the number
        of messages sent, and the delay (s) of the last one. A late sender sends all due messages at once, and
        never fewer.
        """
        if "key" in asked:
            pairs = zip(self._sessions, self._names, strict=True)
            self._puts = [
                session.declare_publisher(robot_key(robot, "state", str(asked["key"])))
                for session, robot in pairs
            ]
            return {}
        rate, seconds, start = (float(asked[name]) for name in ("rate", "seconds", "start"))
        time.sleep(max(0.0, start - time.monotonic()))
        return self._send(start, rate * len(self._puts), round(rate * seconds) * len(self._puts))

    def _send(self, start: float, rate: float, total: int) -> Asked:
        sent = 0
        count = len(self._puts)
        while sent < total:
            due = min(total, int((time.monotonic() - start) * rate) + 1)
            for place in range(sent, due):
                self._puts[place % count].put(self._payload, attachment=STAMP.pack(time.monotonic()))
            sent = due
            time.sleep(SLOT)
        return {"sent": sent, "late": time.monotonic() - start - total / rate}


class FleetListener:
    """Subscriber that counts messages on keys and records their transit times."""

    def __init__(self, endpoint: str) -> None:
        self._session = opened(endpoint)
        self._subscribers: list[Any] = []
        self._ways = array("d")

    def answer(self, asked: Asked) -> Asked:
        """Execute one command, or return the statistics since the last call.

        `listen`: subscribe to these keys from now on, and no others. `alive`: return the number of robots
        that are alive. Otherwise: message count, and transit time (s) at ranks 0.5 and 0.99.
        """
        if "listen" in asked:
            for each in self._subscribers:
                each.undeclare()
            self._subscribers = [
                self._session.declare_subscriber(key, self._receive) for key in asked["listen"]
            ]
            return {}
        if "alive" in asked:
            replies = self._session.liveliness().get(f"{ROOT}/*/alive")
            return {"alive": sum(1 for reply in replies if reply.ok is not None)}
        ways = sorted(self._ways)
        self._ways = array("d")
        ranks = {str(rank): ways[int(rank * (len(ways) - 1))] for rank in (0.5, 0.99)} if ways else {}
        return {"count": len(ways), "way": ranks}

    def _receive(self, sample: zenoh.Sample) -> None:
        now = time.monotonic()
        attachment = sample.attachment
        if attachment is not None:
            self._ways.append(now - STAMP.unpack(attachment.to_bytes())[0])


def main(arguments: list[str]) -> None:
    """Run one process: router ENDPOINT | robots ENDPOINT FIRST COUNT PAYLOAD-FILE | listener ENDPOINT"""
    what, endpoint, *rest = arguments
    part: FleetRouter | SimulatedRobots | FleetListener
    if what == "router":
        part = FleetRouter(endpoint)
    elif what == "robots":
        with open(rest[2], "rb") as file:
            part = SimulatedRobots(endpoint, int(rest[0]), int(rest[1]), file.read())
    else:
        part = FleetListener(endpoint)
    _serve(part.answer)


def _serve(answer: Callable[[Asked], Asked]) -> None:
    print("{}", flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)
    os._exit(0)  # sessions whose router has gone before would take seconds to close


if __name__ == "__main__":
    main(sys.argv[1:])
