"""A ROS node over Zenoh for tests of the bridge as a whole: `python ros_bytes_peer.py ENDPOINT`.

It joins by twind's own Zenoh session, in a process of its own; peers that share no code with it are in
`ros_zenoh_peer.py`. One order a line of standard input, one answer a line of standard output, JSON.
"""

import json
import subprocess
import sys
import threading
from collections import deque
from dataclasses import replace
from types import TracebackType
from typing import Any

from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import TOPICS, RosTopic
from twind.bridge.ros.zenoh import ZenohTransport
from twind.ros import decode, encode

THEIRS = {topic.name: replace(topic, out=not topic.out) for topic in TOPICS}  # as a peer has them


class Peer:
    """The process, asked from a test."""

    def __init__(self, endpoint: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, do: str, **parameters: Any) -> Any:
        """Its answer. AssertionError: it failed or ended."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps({"do": do, **parameters}) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, f"the peer ended at {do}: {self.process.poll()}"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["answer"]

    def signal(self, number: int) -> None:
        """Stop it, let it go on, kill it."""
        self.process.send_signal(number)

    def __enter__(self) -> "Peer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait(10)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


class Node:
    """Commands of the process: each public method is one."""

    def __init__(self, endpoint: str) -> None:
        self._heard: dict[str, deque[bytes]] = {name: deque(maxlen=10_000) for name in THEIRS}
        self._graph = ZenohTransport(DiscoverySettings(), lambda line: None, endpoint)
        self._graph.open(list(THEIRS.values()), (), self._hear, lambda *_: (False, ""))

    def received(self, topic: str) -> list[Any]:
        """Messages that came since this was last asked."""
        waiting = self._heard[topic]
        return [decode(THEIRS[topic].kind, waiting.popleft()) for _ in range(len(waiting))]

    def send(self, topic: str, message: dict[str, Any], times: int = 1) -> None:
        """Publish one message so often."""
        data = encode(THEIRS[topic].kind, message)
        for _ in range(times):
            self._graph.publish(THEIRS[topic], data)

    def send_bytes(self, topic: str, data: str) -> None:
        """Publish these bytes, hexadecimal."""
        self._graph.publish(THEIRS[topic], bytes.fromhex(data))

    def flood(self, topic: str, data: str, gap: float) -> None:
        """Publish the bytes of the file `data` every `gap` s, until the process ends."""
        with open(data, "rb") as file:
            message = file.read()

        def run() -> None:
            pause = threading.Event()
            while not pause.wait(gap):
                self._graph.publish(THEIRS[topic], message)

        threading.Thread(target=run, daemon=True).start()

    def _hear(self, topic: RosTopic, data: bytes) -> None:
        self._heard[topic.name].append(data)


def main(endpoint: str) -> None:
    """Obey until standard input ends."""
    node = Node(endpoint)
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"answer": getattr(node, order.pop("do"))(**order)}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
