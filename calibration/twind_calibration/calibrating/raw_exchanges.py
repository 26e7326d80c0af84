"""Topic `raw` of the daemon as readings of actuators, each with the time of its arrival."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from twind.client import Client
from twind.command_line.verb import Rejected
from twind_calibration.calibrating.encoder_unwrap import EncoderSample

LEAST_HZ = 50.0  # readings a second: fewer, and a quick movement goes over the half-turn unseen


@dataclass(frozen=True, slots=True)
class RawExchange:
    """One exchange. `samples`: of every actuator with a reading so far; without a new one the same again."""

    time: float  # s, of the daemon's clock
    samples: Mapping[str, EncoderSample]


@contextlib.contextmanager
def readings(client: Client, rate_hz: float) -> Iterator[Iterator[RawExchange]]:
    """As fast as the loop reads, `rate_hz`. Its end hangs the client up. Raises Rejected, ClientError."""
    if not rate_hz >= LEAST_HZ:
        raise Rejected(
            f"the daemon reads at {rate_hz:g} Hz, a joint moved by hand needs {LEAST_HZ:g}: raise `rate_hz`"
        )
    news = client.stream("Monitor", topics=["raw"], rate=rate_hz)
    try:
        yield (_reading(each) for each in news)
    finally:
        news.close()


def _reading(news: Mapping[str, Any]) -> RawExchange:
    raw = news["raw"]
    time = float(news["time"])
    rows = zip(raw["names"], raw["ticks"], raw["age_ms"], strict=True)
    samples = {
        name: EncoderSample(time - age * 1e-3, int(ticks))
        for name, ticks, age in rows
        if ticks is not None and age is not None
    }
    return RawExchange(time, samples)
