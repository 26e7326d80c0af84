"""The stand-in's own: datagrams on 127.0.0.1, and who is there, by files in $ROS_STAND_IN."""

import json
import os
import socket
from itertools import count
from pathlib import Path

_NUMBERS = count()


class Wire:
    """One node's socket, and its file: name, address, endpoints."""

    def __init__(self, domain, name):
        self._folder = Path(os.environ["ROS_STAND_IN"])
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self.address = list(self._socket.getsockname())
        self._domain = domain
        self._file = self._folder / f"{domain}-{os.getpid()}-{next(_NUMBERS)}.json"
        self._said = {"node": name, "address": self.address, "endpoints": []}
        self._seen = 0
        self._nodes = []
        self._tell()

    def fileno(self):
        return self._socket.fileno()

    def add(self, **endpoint):
        """`what` it is (writer, reader, service), `name`, `kind`, and the qualities of a topic."""
        self._said["endpoints"].append(endpoint)
        self._tell()

    def nodes(self):
        """Everybody who is there, this node too."""
        changed = self._folder.stat().st_mtime_ns
        if changed != self._seen:
            self._seen = changed
            texts = [_text(each) for each in sorted(self._folder.glob(f"{self._domain}-*.json"))]
            self._nodes = [json.loads(each) for each in texts if each]
        return self._nodes

    def endpoints(self, what, name):
        """(node, endpoint) of these."""
        return [
            (node, each)
            for node in self.nodes()
            for each in node["endpoints"]
            if each["what"] == what and each["name"] == name
        ]

    def send(self, address, head, data=b""):
        self._socket.sendto(json.dumps(head).encode() + b"\n" + data, tuple(address))

    def take(self):
        """(head, data) of the datagram that has come."""
        head, _, data = self._socket.recv(1 << 16).partition(b"\n")
        return json.loads(head), data

    def close(self):
        self._file.unlink(missing_ok=True)
        self._socket.close()

    def _tell(self):
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(self._said))
        new.rename(self._file)


def _text(path):
    try:
        return path.read_text()
    except FileNotFoundError:
        return ""
