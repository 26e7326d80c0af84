"""Permitted writes (W2): (address, length) -> the values, and the states. Everything else is refused.

Addresses of the X series' control table. Named for what arming, motion, damping and an operator's register
write need; id, baud rate, protocol, indirect addresses and goals of other modes are not among it.
"""

from dataclasses import dataclass

TORQUE = 64
WATCHDOG = 98
GOAL = 116
GOAL_CURRENT = 102
EEPROM_END = 64


@dataclass(frozen=True)
class Field:
    """One register or block that may be written: words of these sizes, each between these values."""

    words: tuple[tuple[int, int, int], ...]  # (bytes, least, most), unsigned, little-endian
    with_torque: bool = True  # also while torque is on


def _one(size: int, most: int, *, with_torque: bool = True) -> Field:
    return Field(((size, 0, most),), with_torque)


WORD = 0xFFFF
LONG = 0xFFFFFFFF
GAIN = 16383
PWM = 885
PROFILE = 32767

EEPROM = {
    (9, 1): _one(1, 254),
    (10, 1): _one(1, 255),
    (11, 1): _one(1, 16),
    (12, 1): _one(1, 255),
    (20, 4): _one(4, LONG),
    (24, 4): _one(4, 1023),
    (31, 1): _one(1, 100),
    (32, 2): _one(2, 160),
    (34, 2): _one(2, 160),
    (36, 2): _one(2, PWM),
    (38, 2): _one(2, 2047),
    (44, 4): _one(4, 2047),
    (48, 4): _one(4, LONG),
    (52, 4): _one(4, LONG),
    (60, 1): _one(1, 255),
    (62, 1): _one(1, 255),
    (63, 1): _one(1, 255),
}
RAM = {
    (TORQUE, 1): _one(1, 1),
    (65, 1): _one(1, 1),
    (68, 1): _one(1, 2, with_torque=False),
    (76, 2): _one(2, GAIN, with_torque=False),
    (78, 2): _one(2, GAIN, with_torque=False),
    (80, 2): _one(2, GAIN),  # position D, I, P: one by one, or as the block that they are
    (82, 2): _one(2, GAIN),
    (84, 2): _one(2, GAIN),
    (80, 6): Field(((2, 0, GAIN),) * 3),
    (88, 2): _one(2, GAIN, with_torque=False),
    (90, 2): _one(2, GAIN, with_torque=False),
    (WATCHDOG, 1): _one(1, 127),
    (100, 2): _one(2, PWM),
    (GOAL_CURRENT, 2): _one(2, WORD),  # the cap of the servo decides
    (108, 4): _one(4, PROFILE),
    (112, 4): _one(4, PROFILE),
    (108, 8): Field(((4, 0, PROFILE),) * 2),
    (GOAL, 4): _one(4, LONG),  # W1 judges the word
}
FIELDS = EEPROM | RAM


def wrong(address: int, data: bytes, cap: int) -> str:
    """Why these bytes may not stand there; empty: they may."""
    field = FIELDS.get((address, len(data)))
    if field is None:
        return f"register {address}, {len(data)} bytes, is not to be written"
    at = 0
    for size, least, most in field.words:
        value = int.from_bytes(data[at : at + size], "little")
        if address == GOAL_CURRENT:
            most = cap
        if not least <= value <= most:
            return f"register {address + at} := {value}, allowed {least}..{most}"
        at += size
    return ""
