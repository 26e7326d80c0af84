"""The daemon that is streamed from: a thread that takes its readings, over as many daemons as there are."""

import argparse
import threading
from collections.abc import Callable
from dataclasses import replace

from twind.client import Client, ClientError
from twind.client.monitor_stream import RepeatedFaultFilter
from twind.command_line.verb import observer
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.stream_samples import StreamedRobot, sample

SILENCE = 5.0  # s without a message after which the daemon counts as gone
# s between two looks, and messages that come meanwhile: to be woken for each would cost three times the CPU.
# Twenty of 8 kB find room in the socket, and the front keeps 256 KiB more.
NAP = 0.2
TOGETHER = 20.0
AGAIN = 0.5  # s between two attempts to reach one


class ReadingSubscriber:
    """From `start` to the end of the process. `tell` gets a line when the daemon goes and comes."""

    def __init__(
        self,
        options: argparse.Namespace,
        batcher: SampleBatcher,
        now: Callable[[], float],
        tell: Callable[[str], None],
    ) -> None:
        self._options = options
        self._basket = batcher
        self._now = now
        self._tell = tell
        self._once = RepeatedFaultFilter()
        self._stop = threading.Event()
        self.error = ""  # why there is no daemon
        self._thread = threading.Thread(target=self._run, name="listening", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def stop(self) -> None:
        """Take no more. Returns when that is so, or after a second."""
        self._stop.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._follow()
                if self._stop.is_set():
                    return
                self.error = "the daemon ended the stream"
            except ClientError as error:
                self.error = str(error)
            except Exception as error:  # noqa: BLE001  a thread that dies in silence would look like a daemon without readings
                self.error = f"a message of the daemon cannot be decoded: {type(error).__name__}: {error}"
            self._report_error(self.error)
            self._stop.wait(AGAIN)

    def _follow(self) -> None:
        """One daemon, to its end. Raises ClientError."""
        with observer(self._options) as client:
            client.timeout = SILENCE
            robot = _fetch_robot(client)
            rate = self._options.rate
            for burst in client.bursts("Monitor", topics=["state"], rate=rate):
                for data in burst:
                    read = sample(data)
                    if read.mode is not None and read.mode != robot.mode:
                        robot = replace(robot, mode=read.mode)
                    self._basket.put(read, robot)
                if self.error:
                    self.error = ""
                    self._report_error("")
                if self._stop.wait(min(NAP, TOGETHER / rate)):
                    break

    def _report_error(self, wrong: str) -> None:
        if self._once.is_transition(wrong, self._now()):
            self._tell(f"{wrong}; waiting for the daemon" if wrong else "the daemon is there again")


def _fetch_robot(client: Client) -> StreamedRobot:
    status = client.call("GetStatus")["status"]
    individual = client.call("GetParameters")["parameters"].get("individual")
    return StreamedRobot(status["robot"], str(individual or ""), status["version"], status["mode"])
