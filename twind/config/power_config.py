"""Sections `power` and `stop_button` of a robot file: the supply relay and the physical stop button.

Knows the file alone: whether the devices exist is found out by the process that uses them (`twind/power/`).
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text

Line = Annotated[int, Meta(ge=0, le=1023)]
LEAST_TICKS = 3  # ticks that the relay's timeout covers at least: a late tick is no dead loop


@dataclass(frozen=True, slots=True)
class RelaySpec:
    """Supply relay: closed while the loop runs."""

    kind: str  # lcus1, rts or gpio
    port: str
    line: int  # of a GPIO chip; -1: none
    active_low: bool
    timeout: float  # s without a tick after which it opens
    fall: float  # s after which the supply is gone behind the open relay


@dataclass(frozen=True, slots=True)
class ButtonSpec:
    """Physical stop button."""

    kind: str  # serial, cts, gpio or key
    port: str
    level: str  # of the e-stop: settle or cut
    line: int  # of a GPIO chip; -1: none
    key: int  # of an input device; -1: none


class RelayKeys(ConfigStruct):
    """Section `power.relay`."""

    kind: Literal["lcus1", "rts", "gpio"]
    """USB relay LCUS-1, line RTS of a serial port, or a GPIO line"""
    port: Text
    """device | | `/dev/serial/by-id/…`, or the chip `/dev/gpiochip0`"""
    line: Line | None = None
    """0–1023 | required with `gpio` | line of the chip"""
    active_low: bool = False
    """`gpio` only: the relay closes with the line low"""
    timeout_ms: Annotated[float, Meta(ge=50.0, le=1000.0)] = 100.0
    """without a complete tick for so long the relay opens; at least 3 ticks"""
    fall_ms: Annotated[float, Meta(ge=100.0, le=10000.0)] = 1000.0
    """after so long behind the open relay no device may report a supply"""


class PowerKeys(ConfigStruct):
    """Section `power`."""

    relay: RelayKeys | None = None


class StopButtonKeys(ConfigStruct):
    """Section `stop_button`."""

    kind: Literal["serial", "cts", "gpio", "key"]
    """see [stop button](safety.md#stop-button)"""
    port: Text
    """device | | `/dev/serial/by-id/…`, `/dev/gpiochip0`, `/dev/input/by-id/…`"""
    level: Literal["settle", "cut"] = "settle"
    """[level](safety.md#e-stop) of the e-stop"""
    line: Line | None = None
    """0–1023 | required with `gpio` | line of the chip"""
    key: Annotated[int, Meta(ge=1, le=767)] | None = None
    """1–767 | required with `key` | number of the key, as `evtest` shows it"""


def relay_of(top: ConfigReader, given: RelayKeys | None, rate_hz: float) -> RelaySpec | None:
    """The supply relay that the file describes; None: none. Raises ConfigError."""
    if given is None:
        return None
    section = top.section("power").section("relay")
    _require_with(section, "line", given.line, given.kind, "gpio")
    if given.active_low and given.kind != "gpio":
        raise section.refuse("active_low", f"kind {given.kind} has no level: leave it out")
    _require_ticks(section, given.timeout_ms, rate_hz)
    line = -1 if given.line is None else given.line
    timeout = given.timeout_ms / 1e3
    return RelaySpec(given.kind, given.port, line, given.active_low, timeout, given.fall_ms / 1e3)


def button_of(top: ConfigReader, given: StopButtonKeys | None) -> ButtonSpec | None:
    """The stop button that the file describes; None: none. Raises ConfigError."""
    if given is None:
        return None
    section = top.section("stop_button")
    _require_with(section, "line", given.line, given.kind, "gpio")
    _require_with(section, "key", given.key, given.kind, "key")
    line = -1 if given.line is None else given.line
    return ButtonSpec(given.kind, given.port, given.level, line, -1 if given.key is None else given.key)


def _require_with(section: ConfigReader, key: str, value: int | None, kind: str, owner: str) -> None:
    """Raises ConfigError unless `key` is given with kind `owner`, and with no other."""
    if kind == owner and value is None:
        raise section.refuse(key, f"is required with kind {owner} and missing")
    if kind != owner and value is not None:
        raise section.refuse(key, f"only kind {owner} has it, not {kind}: leave it out")


def _require_ticks(section: ConfigReader, timeout_ms: float, rate_hz: float) -> None:
    """Raises ConfigError for a timeout that a late tick exceeds."""
    least = LEAST_TICKS * 1e3 / rate_hz
    if timeout_ms < least:
        message = f"{timeout_ms:g} ms is less than {LEAST_TICKS} ticks at {rate_hz:g} Hz: at least {least:g}"
        raise section.refuse("timeout_ms", message)
