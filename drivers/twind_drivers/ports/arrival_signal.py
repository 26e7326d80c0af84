"""Signal at each arrival of bytes at a terminal, as a descriptor to poll.

A kernel worker of normal priority carries the bytes of every serial port and pseudo-terminal. A poll of an
empty terminal and a read of it wait until that worker has run (`tty_buffer_flush_work` in drivers/tty/n_tty.c
of Linux 6.18), past any timeout and whatever the caller's priority: beside programs that compute, a loop
under SCHED_FIFO was stopped for 0.1 to 0.7 s. With O_ASYNC the worker sends a signal once bytes can be read,
and a signalfd is polled without waiting for any worker. What remains: a read of bytes whose signal comes
later leaves that signal, and the read that follows it finds nothing and may wait for the worker.
"""

import ctypes
import fcntl
import os
import signal
import threading
from collections.abc import Iterable

F_SETSIG, F_SETOWN_EX, F_OWNER_TID = 10, 15, 0  # asm-generic/fcntl.h, the same on x86 and ARM
RECORD = 128  # bytes of struct signalfd_siginfo; the first is the number of the signal (little-endian)
MOST = 32  # records of one read

_live: set["ArrivalSignal"] = set()  # of this process


class ArrivalSignal:
    """Announces bytes of the terminal `terminal` to the thread that made this object; no other may use it.

    `fd`: descriptor to poll.
    """

    def __init__(self, terminal: int) -> None:
        """Take a free real-time signal. Raises OSError where none is left, or the kernel refuses."""
        free = set(range(signal.SIGRTMIN, signal.SIGRTMAX + 1)) - {each._number for each in _live}
        if not free:
            raise OSError("all real-time signals of this process are in use")
        self._number: int = max(free)
        self._due = True  # to be read though no signal came: of bytes that came before
        # The kernel sends SIGIO, which ends a process, where the user's queue of signals is full.
        both = {self._number, signal.SIGIO}
        signal.pthread_sigmask(signal.SIG_BLOCK, both)
        self.fd = _signalfd(both)
        try:
            owner = (ctypes.c_int * 2)(F_OWNER_TID, threading.get_native_id())
            fcntl.fcntl(terminal, F_SETOWN_EX, bytes(owner))
            fcntl.fcntl(terminal, F_SETSIG, self._number)
            fcntl.fcntl(terminal, fcntl.F_SETFL, fcntl.fcntl(terminal, fcntl.F_GETFL) | os.O_ASYNC)
        except OSError:
            os.close(self.fd)
            raise
        _live.add(self)

    def take(self) -> bool:
        """Return True if bytes may have come since the last call; then the terminal must be read."""
        announced = self._due
        self._due = False
        try:
            while records := os.read(self.fd, MOST * RECORD):
                announced = True
                if signal.SIGIO in records[::RECORD]:  # it names no terminal
                    for each in _live - {self}:
                        each._due = True
                if len(records) < MOST * RECORD:
                    break
        except BlockingIOError:
            pass
        return announced

    def repeat(self) -> None:
        """Announce again: not all bytes were read."""
        try:
            signal.pthread_kill(threading.get_ident(), self._number)
        except OSError:  # the queue is full; SIGIO needs no place in it
            signal.pthread_kill(threading.get_ident(), signal.SIGIO)

    def close(self) -> None:
        """Release the signal, which stays blocked. The terminal must be closed by then."""
        self.take()
        os.close(self.fd)
        _live.discard(self)


def _signalfd(signals: Iterable[int]) -> int:
    """Open a signalfd (signalfd(2)); Python has no call for it."""
    word = 8 * ctypes.sizeof(ctypes.c_ulong)
    mask = (ctypes.c_ulong * (1024 // word))()  # sigset_t of the C library has 1024 bits
    for number in signals:
        mask[(number - 1) // word] |= 1 << (number - 1) % word
    library = ctypes.CDLL(None, use_errno=True)
    fd: int = library.signalfd(-1, mask, os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), "signalfd")
    return fd
