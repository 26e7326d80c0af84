"""Executors: they put arrivals in order, and the callbacks of a group wait for each other."""

import os
import select
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor


class Executor:
    def __init__(self, *, context=None):
        self._context = context
        self._nodes = []
        self._ready = deque()
        self._ended = False
        self._hear, self._wake = os.pipe()
        os.set_blocking(self._wake, False)

    def add_node(self, node):
        self._nodes.append(node)
        node.executor = self
        return True

    def wake(self):
        os.write(self._wake, b".")

    def soon(self, group, call):
        """From any thread: `call` when its group is free."""
        self._ready.append((group, call))
        if not self._ended:
            self.wake()

    def spin_once(self, timeout_sec=None):
        end = None if timeout_sec is None else time.monotonic() + timeout_sec
        while self._context.ok() and not self._ended:
            for each in list(self._ready):
                if each[0] is None or each[0].free():
                    self._ready.remove(each)
                    self._begin(*each)
                    return
            left = None if end is None else end - time.monotonic()
            if left is not None and left <= 0.0:
                return
            self._wait(left)

    def _wait(self, left):
        wires = {node.wire.fileno(): node for node in self._nodes}
        for fd in select.select([self._hear, *wires], [], [], left)[0]:
            if fd == self._hear:
                os.read(fd, 4096)
            else:
                wires[fd].take()

    def _run(self, group, call):
        try:
            call()
        finally:
            if group is not None:
                group.busy = False
            if not self._ended:
                self.wake()

    def shutdown(self, timeout_sec=None):
        self._ended = True
        return True


class SingleThreadedExecutor(Executor):
    def _begin(self, group, call):
        self._run(group, call)


class MultiThreadedExecutor(Executor):
    def __init__(self, num_threads=None, *, context=None):
        super().__init__(context=context)
        self._pool = ThreadPoolExecutor(num_threads)
        self._begun = []

    def _begin(self, group, call):
        if group is not None:
            group.busy = True
        self._begun.append(self._pool.submit(self._run, group, call))
        over = [each for each in self._begun if each.done()]
        self._begun = [each for each in self._begun if each not in over]
        for each in over:
            each.result()  # raises what a callback raised, as the real one does

    def shutdown(self, timeout_sec=None, *, wait_for_threads=True):
        super().shutdown(timeout_sec)
        self._pool.shutdown(wait=wait_for_threads)
        return True
