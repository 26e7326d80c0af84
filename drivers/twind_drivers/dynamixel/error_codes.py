"""Error codes of the Y series, as the hardware error bits of the other models. Pure.

Source: e-manual, "Error Code (153)". A tripped bus watchdog (18) is no hardware error: its register tells it.
A low battery (9) is a warning: torque stays on.
"""

SUPPLY = 0x01
OVERHEATING = 0x04
ENCODER = 0x08
INVERTER = 0x10
OVERLOAD = 0x20
HELD = 0x40  # no bit of other models: it holds its position, and takes no goal until a restart
WATCHDOG = 18  # code
# By bit: the code that stands for it in a virtual servo.
CODE_BY_BIT = {SUPPLY: 2, OVERHEATING: 4, ENCODER: 13, INVERTER: 7, OVERLOAD: 5}


def _bits(code: int) -> int:
    groups = {
        SUPPLY: (1, 2),
        OVERHEATING: (3, 4),
        OVERLOAD: (5,),
        INVERTER: (7,),
        ENCODER: (10, 11, 12, 13, 14, 15),
        HELD: (17, 19, 20),
    }
    known = {each: bit for bit, codes in groups.items() for each in codes}
    return 0 if code in (0, 9, WATCHDOG) else known.get(code, HELD)


BITS_BY_CODE = tuple(_bits(code) for code in range(256))
