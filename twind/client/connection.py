"""Blocking connection to the daemon: calls, streams, typed errors, bounded waits. Standard library only."""

import json
import os
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from twind.client.client_line import ClientLine, SocketLine
from twind.client.errors import ClientError, Disconnected, NoAnswer, NoDaemon, NotCarried, as_error
from twind.client.find_socket import socket_path

INTERFACE = "io.twind.Control"
TIMEOUT = 35.0  # s; the daemon answers every call within 30 s, a scan within 60

Answer = dict[str, Any]


class Client:
    """One connection, made at the first call. The lease belongs to it and ends with it.

    `path` is the folder of the sockets or a socket; `name` which of the two: `control` or `observe`. `line`,
    instead of both: the transport of the messages. `timeout` is the longest wait for one answer, s. `cut` and
    `notify` may be called from any thread.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        name: str = "control",
        timeout: float = TIMEOUT,
        line: ClientLine | None = None,
    ) -> None:
        self.timeout = timeout
        self._line = SocketLine(socket_path(path, name)) if line is None else line
        self._streaming = False
        self._begun = ""  # the call whose answer has not been read

    def __enter__(self) -> "Client":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """True if a connection is open. False: the next call opens one, which holds no lease."""
        return self._line.is_open

    @property
    def path(self) -> str:
        """Path to the daemon, for display: its socket, or another connection."""
        return self._line.where

    def connect(self) -> None:
        """Connect now rather than at the first call. Raises NoDaemon."""
        self._line.open(self.timeout)

    def close(self) -> None:
        """Close the connection; a lease that it holds ends. The next call connects again."""
        self._line.close()
        self._streaming = False
        self._begun = ""

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Wait at most `seconds` for each answer in the context, instead of `timeout`."""
        usual = self.timeout
        self.timeout = seconds
        try:
            yield
        finally:
            self.timeout = usual

    def cut(self) -> None:
        """Break the connection, from any thread: a call that waits raises Disconnected, a lease lapses."""
        self._line.cut()

    # ------------------------------------------------------------------------------------------ calls

    def call(self, method: str, **parameters: Any) -> Answer:
        """Call and wait for the answer's parameters. None as a parameter means: not given.

        Raises Refused, CallError, NoDaemon, Disconnected, NoAnswer. After a time-out the connection is
        closed: an answer that comes too late must not be taken for that of the next call.
        """
        self._send(method, parameters)
        return self._receive(method)[0]

    def begin(self, method: str, **parameters: Any) -> None:
        """Call without waiting; `finish` reads the answer, before any other call on this connection.

        Raises NoDaemon; NoAnswer if the daemon does not even read the call.
        """
        self._send(method, parameters)
        self._begun = method

    def finish(self) -> Answer | None:
        """Wait for the answer to the call of `begin`; None: there was none. Raises as `call`."""
        method = self._begun
        self._begun = ""
        return self._receive(method)[0] if method else None

    def notify(self, method: str, **parameters: Any) -> None:
        """Call `oneway`: without an answer, at once, also while another call of this connection waits.

        May be called from any thread; on a closed connection it does nothing. A refusal is not reported.
        Raises NotCarried: only a socket carries it; NoAnswer: the daemon does not read.
        """
        if not isinstance(self._line, SocketLine):
            raise NotCarried(f"{method}: a call without an answer needs a socket; {self.path} is none")
        if not self._line.is_open:
            return
        message = _message(method, parameters, {"oneway": True})
        try:
            self._line.send(message, self.timeout)
        except TimeoutError:
            raise NoAnswer(f"{method}: the daemon did not read the call within {self.timeout:g} s") from None

    def is_hung_up(self) -> bool:
        """Return True if the daemon has ended the connection since the last call."""
        return isinstance(self._line, SocketLine) and self._line.is_hung_up()

    def stream(self, method: str, **parameters: Any) -> Generator[Answer, None, None]:
        """Call with `more`; yield the parameters of each answer. The call is sent at once.

        Leaving it before its end closes the connection. Raises as `call`.
        """
        self._send(method, parameters, more=True)
        return self._answers(method)

    def bursts(self, method: str, **parameters: Any) -> Generator[list[bytes], None, None]:
        """Stream as `stream` does, but yield all received answers, at least one, as bytes: for fast streams.

        A slow reader is woken seldom. The bytes are not decoded: the caller detects errors and the last
        answer. Leaving the iterator closes the connection. Raises NoDaemon, Disconnected, NoAnswer.
        """
        self._send(method, parameters, more=True)
        return self._bursts(method)

    def _bursts(self, method: str) -> Generator[list[bytes], None, None]:
        try:
            while True:
                yield [self._next(method), *self._line.take_received()]
        finally:
            self.close()

    def _answers(self, method: str) -> Generator[Answer, None, None]:
        ended = False
        try:
            while not ended:
                answer, goes_on = self._receive(method)
                ended = not goes_on
                self._streaming = goes_on
                yield answer
        finally:
            if self._streaming:
                self.close()

    # ------------------------------------------------------------------------------------------ messages

    def _send(self, method: str, parameters: Mapping[str, object], *, more: bool = False) -> None:
        if self._streaming:
            raise RuntimeError(f"{method}: a stream is open on this connection; use another Client")
        if self._begun:
            raise RuntimeError(f"{method}: {self._begun} is not answered yet on this connection: finish it")
        data = _message(method, parameters, {"more": True} if more else {})
        self.connect()
        self._streaming = more
        try:
            self._line.send(data, self.timeout)
        except TimeoutError:
            self.close()
            raise NoAnswer(f"{method}: the daemon did not read the call within {self.timeout:g} s") from None
        except BaseException:  # Ctrl-C: the answer that comes must not be taken for that of the next call
            self.close()
            raise

    def _receive(self, method: str) -> tuple[Answer, bool]:
        """Return the parameters of the next answer, and whether more follow."""
        data = self._next(method)
        try:
            message = _understood(data)
        except (ValueError, RecursionError) as error:
            self.close()  # the beginning of its next message is unknown
            raise Disconnected(
                f"{self.path}: the answer to {method} is no valid message ({error}); connection closed"
            ) from None
        parameters = message.get("parameters") or {}
        if message.get("error"):
            self._streaming = False
            raise as_error(message["error"], parameters)
        return parameters, bool(message.get("continues"))

    def _next(self, method: str) -> bytes:
        """Return the bytes of the next message."""
        if not self._line.is_open:
            raise Disconnected(f"{self.path}: the connection is closed")
        try:
            return self._line.receive(self.timeout)
        except TimeoutError:
            self.close()
            raise NoAnswer(f"{method}: no answer from the daemon within {self.timeout:g} s") from None
        except EOFError:
            self.close()
            raise Disconnected(f"{self.path}: the daemon closed the connection during {method}") from None
        except BaseException:  # Ctrl-C too: the answer must not be taken for that of the next call
            self.close()
            raise


def first_open(path: str | os.PathLike[str] | None, *names: str, timeout: float = TIMEOUT) -> Client:
    """Connect to the first of the sockets `names` that permits it. Raises the NoDaemon of the last."""
    failure = NoDaemon(f"{path}: no socket was named")
    for name in names:
        client = Client(path, name=name, timeout=timeout)
        try:
            client.connect()
        except NoDaemon as error:
            failure = error
        else:
            return client
    raise failure


def _message(method: str, parameters: Mapping[str, object], flags: Mapping[str, object]) -> bytes:
    """Return a call as bytes; numbers of numpy and its arrays are taken. Raises ClientError."""
    message: dict[str, object] = {
        "method": method if "." in method else f"{INTERFACE}.{method}",
        "parameters": {key: value for key, value in parameters.items() if value is not None},
        **flags,
    }
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":"), default=_plain).encode()
    except ValueError:
        raise ClientError(f"{method}: a number is NaN or infinite; only finite ones can be sent") from None
    except TypeError as error:
        raise ClientError(f"{method}: {error}") from None


def _plain(value: object) -> object:
    """Return a value of numpy, or of another array library, as numbers and lists. Raises TypeError."""
    tolist = getattr(value, "tolist", None)
    if tolist is None:
        raise TypeError(f"{type(value).__name__} is no number, text, list or mapping")
    found: object = tolist()
    return found


def _understood(data: bytes) -> Answer:
    """Parse one message. Raises ValueError, RecursionError: it is not valid."""
    message = json.loads(data)
    if not isinstance(message, dict):
        raise ValueError("not an object")
    if not isinstance(message.get("parameters") or {}, dict):
        raise ValueError("its parameters are not an object")
    if not isinstance(message.get("error") or "", str):
        raise ValueError("its error is not a name")
    return message
