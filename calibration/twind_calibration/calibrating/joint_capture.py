"""Readings of a joint that is held still, and whether it was. Pure."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, pstdev
from typing import Any

from twind.client import Client
from twind.command_line.verb import Rejected
from twind_calibration.calibrating.encoder_unwrap import EncoderSample, shortest

SAMPLES = 50
MOST_SIGMA = 3.0  # ticks of 4096 a turn: standard deviation of a joint that is held
TURN = 4096  # ticks of the turn that bound is meant for
THIRD = 3  # the first and the last third of the readings are compared: a slow movement is one too


@dataclass(frozen=True, slots=True)
class JointCapture:
    """Readings of one joint. `mean` in ticks, on the turn of the first reading."""

    count: int
    mean: float
    sigma: float  # ticks
    wrong: str = ""  # why it does not count; "": it does


def capture(readings: Sequence[int], ticks_per_turn: int, least: int = SAMPLES) -> JointCapture:
    """Mean and spread of the readings; refused: too few, spread over 3 ticks, or a movement under way."""
    if not readings:
        return JointCapture(0, 0.0, 0.0, "no reading arrived")
    first = readings[0]
    way = [first + shortest(each - first, ticks_per_turn) for each in readings]  # 4095 and 0 are neighbours
    mean = fmean(way)
    sigma = pstdev(way)
    most = MOST_SIGMA * max(1.0, ticks_per_turn / TURN)
    third = max(1, len(way) // THIRD)
    drift = fmean(way[-third:]) - fmean(way[:third])
    wrong = ""
    if len(way) < least:
        wrong = f"{len(way)} readings came, {least} are needed"
    elif abs(drift) > most:
        wrong = f"it moved: {drift:+.1f} ticks from the first readings to the last, at most {most:g}"
    elif not sigma <= most:
        wrong = f"its readings spread by {sigma:.1f} ticks (standard deviation), at most {most:g}"
    return JointCapture(len(way), mean, sigma, wrong)


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
