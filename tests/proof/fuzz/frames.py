"""Bytes to a real front over real sockets: every connection is answered or closed, and the front lives on."""

import json
import os
import shutil
import socket
import tempfile
import time
from pathlib import Path
from random import Random
from typing import Any, Protocol

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.mangle import mangled, pieces
from tests.support.loop_stand_in import NAMES, StandIn
from twind import link
from twind.front.reload_queue import ANSWER, READING
from twind.protocol import CONTROL, SERVICE, idl, load

PATIENCE = 5.0  # s in which a connection is answered or closed
RELOAD = READING + ANSWER  # s that the front takes for a reload at most; what it would change waits as long
QUIET = 0.5  # s without a word before something happens that is told to whoever watches
NOTHING: dict[str, list[object]] = {"refusals": [], "warnings": [], "changes": []}
GROWTH = 96 << 20  # bytes that the front may grow from its first thousand frames on
# Whichever ends a message on this connection, a zero or a line break, this is one of its own.
LAST = b"\n" + json.dumps({"method": f"{SERVICE}.GetInfo"}).encode() + b"\n\0"
SETTLED = 1000  # frames after which its size is measured
CHECKED = 200  # frames between two questions whether it is alive
WORDS = (
    "",
    "reject",
    "retime",
    "state",
    "events",
    "raw",
    "live",
    "cut",
    "settle",
    "main",
    "é\n\x00",
    "a" * 300,
)
INTS = (0, 1, -1, 252, 2**31, -(2**63), 2**63 - 1, 2**63, 2**64, 10**400)
FLOATS = (0.0, -0.0, 0.5, 1e-320, 1.7e308, -1e300, 3.0)
TEXTS = (
    *(
        "NaN",
        "-Infinity",
        "1e999",
        "[" * 17 + "]" * 17,
        "[" * 100_000,
        '{"a":1,"a":2}',
        "9" * 5000,
        "01",
        "+1",
    ),
    *('"\\ud800"', '"\\u0000"', "tru", "'a'", "/**/1", "1.", "0x1", '"\t"', "", "null", '{"a":{}', '"'),
)


class StandInTarget:
    """A front with a loop that stands in, started to be attacked.

    `folder` has its sockets, `attacked` names those that are connected to, the more often the more.
    """

    attacked: tuple[str, ...] = ("control", "control", "observe")

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="twind-fuzz-"))
        self._loop = StandIn(self.folder)

    def cause_news(self) -> None:
        """An event and a verdict, for calls that wait for one."""
        now = time.monotonic()
        self._loop.send(link.Event(time=now, sequence=1, level="info", code="FUZZ", message="happened"))
        self._loop.send(link.VerdictReport(time=now, sequence=1, id="fuzz", verdict=NOTHING))

    def forget(self) -> None:
        """Drop what the loop was asked."""
        self._loop.commands.clear()
        self._loop.paths.clear()

    def require_running(self) -> None:
        """Raise AssertionError where the front has ended, or a call broke it."""
        assert self._loop.front.poll() is None, f"the front ended with {self._loop.front.poll()}"
        log = self._loop.log.read_text()
        assert "CALL_BROKE" not in log, log[-2000:]

    def resident(self) -> int | None:
        """Bytes that it keeps in memory; None: it has ended."""
        if self._loop.front.poll() is not None:
            return None
        return resident(self._loop.front.pid)

    def close(self) -> None:
        """End the front."""
        self._loop.close()
        shutil.rmtree(self.folder)


class Target(Protocol):
    """Sockets to attack: `StandInTarget`, or those of a service (`tests/proof/fuzz/service_frames.py`)."""

    folder: Path
    attacked: tuple[str, ...]

    def cause_news(self) -> None: ...
    def forget(self) -> None: ...
    def require_running(self) -> None: ...
    def resident(self) -> int | None: ...
    def close(self) -> None: ...


def resident(pid: int) -> int:
    """Bytes that a process keeps in memory."""
    pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


class Frames(FuzzTarget):
    """Sockets, attacked one connection after the other."""

    def __init__(self, target: Target | None = None) -> None:
        self._target = StandInTarget() if target is None else target
        self.interfaces = [load(CONTROL), load(SERVICE)]
        self.frames = self.answered = self.hung_up = self.connections = 0
        self.slowest = 0.0
        self._reload_until = 0.0  # s, by the monotonic clock
        self.size: int | None = None
        self._checked = 0
        self._alive()

    def one(self, rng: Random) -> int:
        """One connection with some frames; how many. Raises whatever is wrong."""
        frames = [self._frame(rng) for _ in range(rng.choice((1, 3, 8, 20)))]
        self._converse(rng, rng.choice(self._target.attacked), b"\0".join(frames) + b"\0")
        self.frames += len(frames)
        self._target.forget()
        if self.frames - self._checked > CHECKED:
            self._checked = self.frames
            self._alive()
        if self.size is None and self.frames > SETTLED:
            self.size = self._target.resident()
        return len(frames)

    def finish(self) -> str:
        """Alive to the end, no bigger, and no handler broke; the summary."""
        self._alive()
        assert self._grown() < GROWTH, f"grew by {self._grown()} bytes from {self.size}"
        return (
            f"{self.connections} connections, {self.answered} answers, {self.hung_up} hung up by the front, "
            f"slowest {self.slowest:.2f} s, grown {self._grown() >> 10} KiB"
        )

    def close(self) -> None:
        """End what was started."""
        self._target.close()

    # -------------------------------------------------------------------------------------- one connection

    def _converse(self, rng: Random, name: str, data: bytes) -> None:
        """All of it is sent, in pieces; then the front has `PATIENCE` to answer or hang up, `RELOAD` for one.

        Behind it stands a call whose answer is known. A stream that was begun keeps it waiting, and is an
        answer itself. Some peers say no more and wait for the end, or leave without a word.
        """
        begun = time.monotonic()
        if b"Reload" in data:
            self._reload_until = begun + RELOAD
        patience = max(PATIENCE, self._reload_until - begun)
        self.connections += 1
        ending = rng.choices(("last call", "half closed", "gone"), (90, 3, 7))[0]
        data += LAST if ending == "last call" else b""
        with socket.socket(socket.AF_UNIX) as peer:
            peer.connect(str(self._target.folder / f"{name}.sock"))
            peer.settimeout(patience)
            try:
                for piece in pieces(rng, data) if len(data) < 5000 else [data]:
                    peer.sendall(piece)
                if ending == "gone":
                    return
                if ending == "half closed":
                    peer.shutdown(socket.SHUT_WR)
                tail = b""
                while heard := self._replies(peer, patience):
                    self.answered += heard.count(b"\0") + heard.count(b"\n")
                    tail = tail[-1000:] + heard
                    if ending == "last call" and (b'"interfaces"' in tail or b'"continues":true' in tail):
                        break
                    assert time.monotonic() - begun < 2 * patience, "neither answered nor closed"
                else:
                    self.hung_up += ending == "last call"
            except (BrokenPipeError, ConnectionResetError):
                self.hung_up += 1
        self.slowest = max(self.slowest, time.monotonic() - begun)

    def _replies(self, peer: socket.socket, patience: float) -> bytes:
        """Replies within `patience` s. For a call that monitors events or verdicts, one is caused."""
        begun = time.monotonic()
        peer.settimeout(QUIET)
        while True:
            try:
                return peer.recv(1 << 18)
            except TimeoutError:
                if time.monotonic() - begun > patience:
                    raise
                self._target.cause_news()

    def _alive(self) -> None:
        """A new peer is answered."""
        self._target.require_running()
        begun = time.monotonic()
        while True:
            with socket.socket(socket.AF_UNIX) as peer:
                peer.connect(str(self._target.folder / f"{self._target.attacked[0]}.sock"))
                peer.settimeout(PATIENCE)
                peer.sendall(json.dumps({"method": f"{CONTROL}.GetStatus"}).encode() + b"\0")
                heard = b""
                while not heard.endswith(b"\0") and (more := peer.recv(1 << 18)):
                    heard += more
            if b'"status"' in heard:
                return
            # All places may still be taken by connections that were just left, or no tick has come yet.
            assert time.monotonic() - begun < PATIENCE, heard[:300]
            time.sleep(0.02)

    def _grown(self) -> int:
        """Bytes since `size` was measured; 0 where it was not."""
        now = self._target.resident()
        return 0 if self.size is None or now is None else now - self.size

    # -------------------------------------------------------------------------------------------- frames

    def _frame(self, rng: Random) -> bytes:
        kind = rng.randrange(12)
        if kind == 0:
            return rng.randbytes(rng.randrange(200)).replace(b"\0", b"\1")
        if kind == 1:
            return rng.choice(TEXTS).encode()
        call = self._call(rng)
        if kind == 2:
            call[rng.choice(("x", "method", "parameters", "more"))] = self._wrong(rng)
        if kind <= 5:
            self._spoil(rng, call)
        text = json.dumps(call, ensure_ascii=rng.random() < 0.5)
        if kind == 6:  # one value is a trap that no serialiser would write
            at = text.rfind(":", 0, rng.randrange(len(text)) + 1) + 1
            text = text[:at] + rng.choice(TEXTS) + text[text.find(",", at) :]
        data = text.encode("utf-8", "surrogatepass")
        if kind == 7:
            data = mangled(rng, data)
        if rng.random() < 0.002:
            data += b" " * rng.choice((60_000, 70_000, 5 << 20))
        return data

    def _call(self, rng: Random) -> dict[str, Any]:
        """A call that the interface allows."""
        interface = rng.choice((self.interfaces[0],) * 9 + (self.interfaces[1],))
        method = rng.choice(list(interface.methods.values()))
        call: dict[str, Any] = {"method": f"{interface.name}.{method.name}"}
        call["parameters"] = self._value(rng, method.parameters)
        for key in ("more", "oneway", "upgrade"):
            if rng.random() < 0.12:
                call[key] = rng.random() < 0.7
        return call

    def _value(self, rng: Random, kind: idl.IdlType) -> Any:
        """Something of this type of the interface."""
        if isinstance(kind, idl.OptionalType):
            return None if rng.random() < 0.4 else self._value(rng, kind.of)
        if isinstance(kind, idl.NamedType):
            return self._value(rng, kind.types[kind.name])
        if isinstance(kind, idl.StructType):
            chosen = {name: self._value(rng, each) for name, each in kind.fields.items()}
            return {name: value for name, value in chosen.items() if value is not None or rng.random() < 0.2}
        if isinstance(kind, idl.ListType):
            return [self._value(rng, kind.of) for _ in range(rng.choice((0, 1, 2, 2, 24, 60)) % 25)]
        if isinstance(kind, idl.MapType):
            return {rng.choice(WORDS): self._value(rng, kind.of) for _ in range(2)}
        if isinstance(kind, idl.EnumType):
            return rng.choice(kind.words)
        assert isinstance(kind, idl.ScalarType)
        return {
            "bool": lambda: rng.random() < 0.5,
            "int": lambda: rng.choice(INTS[:7]),
            "float": lambda: rng.choice((*FLOATS, rng.uniform(-1.0, 1.0))),
            "string": lambda: rng.choice((*WORDS, *NAMES[:4])),
            "object": lambda: {rng.choice(WORDS): rng.choice((1, "x", None, [], {}))},
        }[kind.name]()

    def _wrong(self, rng: Random) -> Any:
        return rng.choice((None, True, 1, -1.5, "x", [], {}, [[]], {"a": [1]}, rng.choice(INTS), "\ud800"))

    def _spoil(self, rng: Random, value: Any) -> None:
        """Somewhere in it a value of the wrong type, a field too many or too few."""
        while True:
            keys = list(value) if isinstance(value, dict) else list(range(len(value)))
            if not keys:
                return
            key = rng.choice(keys)
            if isinstance(value[key], dict | list) and value[key] and rng.random() < 0.8:
                value = value[key]
                continue
            what = rng.randrange(3)
            if what == 0 and isinstance(value, dict):
                value[rng.choice(WORDS)] = self._wrong(rng)
            elif what == 1:
                del value[key]
            else:
                value[key] = self._wrong(rng)
            return
