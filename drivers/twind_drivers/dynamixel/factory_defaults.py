"""Factory values and ranges of a new servo's registers: the columns "Initial Value" and "Range".

Raw units. Source: each model's e-manual page (`dynamixel_models.page`), as printed in the newest edition at
hand. A value that the page leaves open ("-") is None. Ranges that a whole series shares are in
`register_rules.py`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

Gains = tuple[int | None, int | None, int | None, int | None, int | None]
UNKNOWN: Gains = (None, None, None, None, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class FactoryDefaults:
    """Register values of one model as delivered, and the ends of their ranges. Raw units."""

    velocity: int  # limit
    current: int | None = None  # limit, also the most it may be; None: no such register
    velocity_most: int = 1023
    gains: Gains = (1920, 100, 0, 0, 800)  # velocity I, P; position D, I, P, in the order of their addresses
    volts: tuple[int, int] = (95, 160)  # what both limits may be, 0.1 V
    # minimum and maximum as delivered, where they are not the ends of that range
    volts_least: int | None = None
    volts_most: int | None = None
    temperature: int = 80  # limit, degC
    acceleration: tuple[int, int] | None = None  # limit as delivered, and at most
    position: tuple[int, int] = (0, 4095)  # what both limits may be
    position_limits: tuple[int, int] = (0, 4095)  # as delivered
    threshold: int = 10  # moving threshold
    threshold_most: int | None = 1023  # None: as the velocity limit
    shutdown: int = 52
    shutdown_most: int = 63
    delay_most: int = 254  # return delay
    slope: int | None = None  # PWM slope
    mode: int = 3


def _x(
    velocity: int, current: int | None = None, *, p: int = 800, of: FactoryDefaults | None = None
) -> FactoryDefaults:
    made = of or FactoryDefaults(velocity=velocity)
    return replace(made, velocity=velocity, current=current, gains=(*made.gains[:4], p))


W6 = (60, 160)
W24 = (110, 300)
V24 = FactoryDefaults(velocity=0, volts=W24)
C430 = FactoryDefaults(velocity=0, volts=W6)
L430 = FactoryDefaults(velocity=0, volts=(60, 140), temperature=72)
X330 = FactoryDefaults(
    velocity=0, velocity_most=2047, temperature=70, volts=(31, 70), volts_least=35, slope=140
)
T330 = replace(X330, volts=(55, 140), volts_least=None, slope=255, current=910, gains=(1200, 40, 0, 0, 900))
MX = FactoryDefaults(velocity=0, acceleration=(32767, 32767))

X_SERIES: Mapping[str, FactoryDefaults] = {
    "xm430_w350": _x(200, 1193),
    "xm430_w210": _x(330, 1193),
    "xh430_w350": _x(130, 648, p=900),
    "xh430_w210": _x(210, 648, p=900),
    "xh430_v350": _x(135, 689, of=V24),
    "xh430_v210": _x(230, 689, of=V24),
    "xd430_t350": _x(130, 648, p=900),
    "xd430_t210": _x(210, 648, p=900),
    "xw430_t333": _x(139, 2047, p=900),
    "xl430_w250": replace(L430, velocity=265, gains=(1000, 100, 4000, 0, 640)),
    "2xl430_w250": replace(L430, velocity=250, gains=(1800, 100, 2000, 0, 640)),
    "xc430_w150": replace(_x(460, p=460, of=C430), threshold=20),
    "xc430_w240": _x(306, p=700, of=C430),
    "2xc430_w250": _x(275, p=700, of=C430),
    "xm540_w270": _x(128, 2047),
    "xm540_w150": _x(230, 2047),
    "xh540_w270": _x(167, 2047),
    "xh540_w150": _x(300, 2047),
    "xh540_v270": _x(128, 2047, of=V24),
    "xh540_v150": _x(230, 2047, of=V24),
    "xd540_t270": _x(167, 2047),
    "xd540_t150": _x(300, 2047),
    "xw540_t260": _x(167, 2047),
    "xw540_t140": _x(304, 2047),
    "xw540_h260": _x(145, 1188, of=V24),
    "xl330_m077": replace(X330, velocity=1620, current=1750, gains=(400, 40, 0, 400, 400), shutdown=53),
    "xl330_m288": replace(X330, velocity=445, current=1750, gains=(1600, 180, 0, 0, 400), shutdown=53),
    "xc330_t181": replace(T330, velocity=510),
    "xc330_t288": replace(T330, velocity=320),
    "xc330_m181": replace(X330, velocity=545, current=2352, gains=(1400, 100, 500, 0, 1200)),
    "xc330_m288": replace(X330, velocity=350, current=2352, gains=(1600, 50, 500, 0, 1100)),
    "mx_28": _x(230, p=850, of=MX),
    "mx_64": _x(285, 1941, p=850, of=MX),
    "mx_106": _x(210, 2047, p=850, of=MX),
}


def _p(
    current: int, velocity: int, acceleration: tuple[int, int], turn: tuple[int, int], gains: Gains
) -> FactoryDefaults:
    """Make the defaults of a P series model.

    `acceleration`: as delivered, at most. `turn`: half a turn, position limit as delivered (counts).
    """
    most, limit = turn
    return FactoryDefaults(
        velocity=velocity,
        velocity_most=velocity,
        current=current,
        gains=gains,
        volts=(150, 350),
        acceleration=acceleration,
        position=(-most, most),
        position_limits=(-limit, limit),
        threshold=20,
        threshold_most=None,
        shutdown=58,
    )


def _ra(
    p_series: FactoryDefaults, acceleration: tuple[int, int], threshold: int, volts: int
) -> FactoryDefaults:
    """Return the defaults of the PRO -R(A) of the same drive train."""
    return replace(
        p_series,
        acceleration=acceleration,
        threshold=threshold,
        volts=(volts, 350),
        volts_least=150,
        gains=UNKNOWN,
        shutdown=52,
        shutdown_most=255,
        delay_most=255,
    )


# Half a turn, and the position limit as delivered.
T_PH42 = (303_750, 303_454)
T_PH54 = (501_923, 501_433)
T_PM42 = (263_187, 262_931)
T_PM54 = (251_417, 251_173)
# Newer pages deliver the acceleration limit at its most; of PH42 and PM54 only the older were at hand.
PH42 = _p(4500, 2920, (10_765, 4_306_173), T_PH42, (502, 1332, 0, 0, 879))
PH54_100 = _p(15_900, 2920, (4_255_632, 4_255_632), T_PH54, (1290, 3593, 0, 0, 502))
PH54_200 = replace(_p(22_740, 2900, (3_992_644, 3_992_644), T_PH54, (2209, 6153, 0, 0, 314)), shutdown=52)
PM42 = _p(1461, 2600, (4_346_756, 4_346_756), T_PM42, (6740, 2145, 0, 0, 1061))
PM54_040 = _p(4470, 2840, (11_037, 4_414_976), T_PM54, (408, 1137, 0, 0, 502))
PM54_060 = _p(7980, 2830, (11_145, 4_457_932), T_PM54, (813, 2265, 0, 0, 502))

P_SERIES: Mapping[str, FactoryDefaults] = {
    "ph42_020_s300": PH42,
    "ph54_100_s500": PH54_100,
    "ph54_200_s500": PH54_200,
    "pm42_010_s260": PM42,
    "pm54_040_s250": PM54_040,
    "pm54_060_s250": PM54_060,
    "h42_20_s300_ra": _ra(PH42, (10_765, 4_306_173), 20, 0),
    "h54_100_s500_ra": _ra(PH54_100, (10_639, 4_255_632), 50, 0),
    "h54_200_s500_ra": _ra(PH54_200, (9982, 3_992_644), 20, 150),
    "m42_10_s260_ra": _ra(PM42, (10_867, 4_346_756), 20, 0),
    "m54_40_s250_ra": _ra(PM54_040, (11_037, 4_414_976), 20, 0),
    "m54_60_s250_ra": _ra(PM54_060, (11_145, 4_457_932), 50, 0),
    # Its page prints voltages of 150..300 beside a delivered maximum of 350: the P series' range stands.
    "rh_p12_rn": replace(
        _p(1984, 2970, (3447, 1_378_788), (0, 0), UNKNOWN),
        position=(0, 1150),
        position_limits=(0, 1150),
        threshold=80,
        shutdown=52,
        shutdown_most=255,
        delay_most=255,
        mode=5,
    ),
}
Y_TURN = 262_144  # counts of half a turn


def _y(current: int, velocity: tuple[int, int], acceleration: tuple[int, int], gear: int) -> FactoryDefaults:
    """Make the defaults of a Y series model. `velocity`, `acceleration`: as delivered, at most."""
    return FactoryDefaults(
        velocity=velocity[0],
        velocity_most=velocity[1],
        current=current,
        gains=(2_446_559, 24_778, 9_090, 0, 6_283_185),
        volts=(160, 400),
        volts_most=320,
        temperature=80 if gear == 1 else 60,
        acceleration=acceleration,
        position=(-(2**31), 2**31 - 1),
        position_limits=(-Y_TURN, Y_TURN),
        threshold=1000 if gear == 1 else 10,
        threshold_most=2**31 - 1,
    )


# The pages of YM070-M001 and -R099, YM080-R051 and the velocity of YM080-M001 were read. Of others:
# at most what M001 has over the gear, as those; as delivered as the same gear of the other size.
Y_M070 = _y(2080, (550_000, 642_200), (44_000, 38_520_000), 1)
Y_M080 = _y(2240, (355_600, 355_600), (44_000, 418_352 * 51), 1)
Y_SERIES: Mapping[str, FactoryDefaults] = {
    **dict.fromkeys(("ym070_210_m001", "ym070_210_b001"), Y_M070),
    **dict.fromkeys(("ym080_230_m001", "ym080_230_b001"), Y_M080),
    **dict.fromkeys(("ym070_210_r051", "ym070_210_a051"), _y(2080, (3921, 12_592), (313, 755_294), 51)),
    **dict.fromkeys(("ym070_210_r099", "ym070_210_a099"), _y(2080, (2020, 6486), (161, 389_090), 99)),
    **dict.fromkeys(("ym080_230_r051", "ym080_230_a051"), _y(2240, (3921, 6972), (313, 418_352), 51)),
    **dict.fromkeys(("ym080_230_r099", "ym080_230_a099"), _y(2240, (2020, 3591), (161, 215_514), 99)),
}
FACTORY: Mapping[str, FactoryDefaults] = {**X_SERIES, **P_SERIES, **Y_SERIES}
