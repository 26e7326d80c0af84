"""Stall torque, no-load speed, stall current, gear and supply of each Dynamixel model, from the vendor.

Source of the X and MX rows: "Specifications" of the model's e-manual page (`dynamixel_models.page`), which
prints the vendor's `_data/dxl_x_info.yml` and `dxl_mx_info.yml`; of XD and XW430: the table of compatible
models that those pages share. "Stall torque is measured from the max torque that it can reach" (page of
XM540-W150): a servo that lifts slowly reaches less.

The P, PRO(A) and Y pages (`dxl_p_info.yml`, `dxl_proa_info.yml`, `dxl_y_info.yml`) print no stall torque, but
a continuous point beside the no-load speed. The stall figures continue the line through both.

Gain law: e-manual, "Position PID Gain": P gain / 128 PWM counts per tick of error. Measured where noted.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import pi

from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.dynamixel_models import Y_SIZES, base
from twind_drivers.virtual.servo_strength import MotorFigures, OperatingPoint

Row = tuple[float, float, float, float]  # V, N·m, rev/min, A, as OperatingPoint


def _of(nominal: float, gear: float, *rows: Row) -> MotorFigures:
    return MotorFigures(points=tuple(OperatingPoint(*row) for row in rows), gear=gear, nominal=nominal)


def continuous_figures(
    gear: float, idle: tuple[float, float], continuous: tuple[float, float, float]
) -> MotorFigures:
    """Return the figures at 24 V. `idle`: rev/min, A; `continuous`: rev/min, N·m, A."""
    rpm, without = idle
    loaded, torque, amperes = continuous
    factor = rpm / (rpm - loaded)  # stall torque per continuous torque
    point = OperatingPoint(24.0, torque * factor, rpm, (amperes - without) * factor)
    return MotorFigures(points=(point,), gear=gear, nominal=24.0, bearable=amperes)


# One motor of each size in all gears: the bare one (M001) has 5675 and 4664, 3190 and 2597 rev/min.
Y070 = 5675.0 / (5675.0 - 4664.0)
Y080 = 3190.0 / (3190.0 - 2597.0)
Y_DIVISOR = 3.66e7  # assumed: P gain as delivered gives full output at 4° of error


def _y(gear: float, factor: float, rpm: float, torque: float, amperes: float) -> MotorFigures:
    """Return the figures at 24 V. `torque`, `amperes`: continuous; `factor`: stall torque per continuous."""
    point = OperatingPoint(24.0, torque * factor, rpm, amperes * factor)
    return MotorFigures(points=(point,), gear=gear, nominal=24.0, bearable=amperes, divisor=Y_DIVISOR)


XM430_W350 = _of(12.0, 353.5, (11.1, 3.8, 43, 2.1), (12.0, 4.1, 46, 2.3), (14.8, 4.8, 57, 2.7))
XH430_W350 = _of(12.0, 353.5, (11.1, 3.1, 27, 1.2), (12.0, 3.4, 30, 1.3), (14.8, 4.2, 37, 1.5))
XH430_W210 = _of(12.0, 212.6, (11.1, 2.2, 46, 1.2), (12.0, 2.5, 50, 1.3), (14.8, 3.1, 62, 1.5))
XH540_W270 = _of(12.0, 272.5, (11.1, 9.2, 36, 4.5), (12.0, 9.9, 39, 4.9), (14.8, 11.7, 46, 5.9))
XH540_W150 = _of(12.0, 152.3, (11.1, 6.6, 66, 4.5), (12.0, 7.1, 70, 4.9), (14.8, 8.5, 86, 5.9))
XL430 = _of(11.1, 258.5, (9.0, 1.0, 47, 1.0), (11.1, 1.4, 57, 1.3), (12.0, 1.5, 61, 1.4))
# What the XL330's page leaves open is fitted to 12 pendulum runs of Rhoban/bam (7.4 V, P 100, 200 and 800;
# mean error 1.6°), with the stall torque and speed of the page. Divisor: the register of the output (124) in
# those runs, 256 at every gain; the manual says 128. Bearable: no overload in 3.7 s at full output.
XL330_M288 = replace(
    _of(5.0, 288.4, (3.7, 0.42, 76, 1.11), (5.0, 0.52, 103, 1.47), (6.0, 0.60, 123, 1.74)),
    divisor=256.0,
    bearable=1.3,
    friction=0.017,
    damping=0.0012,
    load_friction=0.30,
    armature=0.0019,
)
XL330_M077 = replace(
    _of(5.0, 77.5, (3.7, 0.180, 278, 1.11), (5.0, 0.215, 383, 1.47), (6.0, 0.228, 456, 1.74)),
    divisor=256.0,
    bearable=1.3,
    armature=0.0019 * (77.5 / 288.4) ** 2,  # the motor of the M288
)
MX_64 = _of(12.0, 200.0, (11.1, 5.5, 58, 3.9), (12.0, 6.0, 63, 4.1), (14.8, 7.3, 78, 5.2))
MX_106 = _of(12.0, 225.0, (11.1, 8.0, 41, 4.8), (12.0, 8.4, 45, 5.2), (14.8, 10.0, 55, 6.3))

X_FIGURES: Mapping[str, MotorFigures] = {
    "xl330_m077": XL330_M077,
    "xl330_m288": XL330_M288,
    "xc330_m181": _of(5.0, 180.62, (3.7, 0.52, 95, 1.34), (5.0, 0.60, 129, 1.80), (6.0, 0.66, 155, 2.15)),
    "xc330_m288": _of(5.0, 288.35, (3.7, 0.69, 59, 1.34), (5.0, 0.93, 81, 1.80), (6.0, 1.10, 97, 2.15)),
    "xc330_t181": _of(11.1, 180.62, (9.0, 0.65, 83, 0.61), (11.1, 0.76, 104, 0.80), (12.0, 0.80, 113, 0.88)),
    "xc330_t288": _of(11.1, 288.35, (9.0, 0.76, 52, 0.61), (11.1, 0.92, 65, 0.80), (12.0, 1.00, 71, 0.88)),
    "xl430_w250": XL430,
    "2xl430_w250": replace(XL430, gear=257.4),
    "xc430_w150": _of(12.0, 159.59, (9.0, 1.2, 80, 1.1), (11.1, 1.4, 99, 1.3), (12.0, 1.6, 106, 1.4)),
    "xc430_w240": _of(12.0, 245.22, (9.0, 1.4, 52, 1.1), (11.1, 1.7, 65, 1.3), (12.0, 1.9, 70, 1.4)),
    "2xc430_w250": _of(12.0, 257.4, (9.0, 1.3, 48, 1.1), (11.1, 1.6, 59, 1.3), (12.0, 1.8, 64, 1.4)),
    "xm430_w350": XM430_W350,
    "xm430_w210": _of(12.0, 212.6, (11.1, 2.7, 70, 2.1), (12.0, 3.0, 77, 2.3), (14.8, 3.7, 95, 2.7)),
    "xh430_w350": XH430_W350,
    "xh430_w210": XH430_W210,
    "xh430_v350": _of(24.0, 353.5, (24.0, 3.3, 31, 0.7)),
    "xh430_v210": _of(24.0, 212.6, (24.0, 2.6, 52, 0.7)),
    "xd430_t350": XH430_W350,
    "xd430_t210": XH430_W210,
    "xw430_t333": _of(12.0, 333.0, (11.1, 2.9, 29, 1.2), (12.0, 3.1, 31, 1.3), (14.8, 3.6, 39, 1.5)),
    "xm540_w270": _of(12.0, 272.5, (11.1, 10.0, 28, 4.2), (12.0, 10.6, 30, 4.4), (14.8, 12.9, 37, 5.5)),
    "xm540_w150": _of(12.0, 152.3, (11.1, 6.9, 50, 4.2), (12.0, 7.3, 53, 4.4), (14.8, 8.9, 66, 5.5)),
    "xh540_w270": XH540_W270,
    "xh540_w150": XH540_W150,
    "xh540_v270": _of(24.0, 272.5, (24.0, 9.2, 34, 2.4)),
    "xh540_v150": _of(24.0, 152.3, (24.0, 6.4, 60, 2.4)),
    "xd540_t270": XH540_W270,
    "xd540_t150": XH540_W150,
    "xw540_t260": _of(12.0, 260.6, (11.1, 8.8, 37, 4.5), (12.0, 9.5, 40, 4.9), (14.8, 11.2, 48, 5.9)),
    "xw540_t140": _of(12.0, 145.6, (11.1, 6.4, 67, 4.5), (12.0, 6.9, 72, 4.9), (14.8, 8.3, 88, 5.9)),
    "mx_28": _of(12.0, 193.0, (11.1, 2.3, 50, 1.3), (12.0, 2.5, 55, 1.4), (14.8, 3.1, 67, 1.7)),
    # Friction and armature: fits of pendulum runs, Rhoban/bam `params/mx64/m1.json` and `mx106/m1.json`.
    # Divisor: measured there, firmware of Protocol 2.0 (`bam/dynamixel/actuator.py`).
    "mx_64": replace(MX_64, friction=0.090, damping=0.012, armature=0.0120, divisor=141.3),
    "mx_106": replace(MX_106, friction=0.104, damping=0.035, armature=0.0266, divisor=147.0),
}
PH42 = continuous_figures(303.75, (32.7, 0.57), (29.2, 5.1, 1.5))
PH54_100 = continuous_figures(501.923, (33.3, 1.13), (29.2, 25.3, 5.5))
PH54_200 = continuous_figures(501.923, (33.1, 1.65), (29.0, 44.7, 9.3))
# 0.6 A beside 0.52 A idle is too coarse for a torque constant: 0.8 of the back-EMF constant, as the others.
PM42_STALL = 1.7 * 28.0 / (28.0 - 26.0)
PM42 = replace(
    _of(24.0, 257.019, (24.0, PM42_STALL, 28.0, PM42_STALL / (0.8 * 24.0 / (28.0 * 2.0 * pi / 60.0)))),
    bearable=0.6,
)
PM54_040 = continuous_figures(251.417, (28.4, 1.32), (24.2, 3.9, 1.9))
PM54_060 = continuous_figures(251.417, (33.1, 1.25), (28.3, 10.1, 3.0))

FIGURES: Mapping[str, MotorFigures] = {
    **X_FIGURES,
    "ph42_020_s300": PH42,
    "ph54_100_s500": PH54_100,
    "ph54_200_s500": PH54_200,
    "pm42_010_s260": PM42,
    "pm54_040_s250": PM54_040,
    "pm54_060_s250": PM54_060,
    "h42_20_s300_ra": PH42,
    "h54_100_s500_ra": PH54_100,
    "h54_200_s500_ra": PH54_200,
    "m42_10_s260_ra": PM42,
    "m54_40_s250_ra": PM54_040,
    "m54_60_s250_ra": PM54_060,
    "ym070_210_m001": _y(1.0, Y070, 5675.0, 0.32, 11.9),
    "ym070_210_r051": _y(51.0, Y070, 111.3, 8.2, 11.9),
    "ym070_210_r099": _y(99.0, Y070, 57.3, 14.6, 11.0),
    "ym080_230_m001": _y(1.0, Y080, 3190.0, 0.62, 12.6),
    "ym080_230_r051": _y(51.0, Y080, 62.5, 15.8, 12.6),
    "ym080_230_r099": _y(99.0, Y080, 32.2, 26.0, 10.7),
}
# Models whose page prints no figures, and the nearest model that has some: same supply and size.
NEAREST: Mapping[str, str] = {
    "xw540_h260": "xh540_v270",
    "rh_p12_rn": "pm42_010_s260",
    # Those with a brake (B) or another housing (A): the motor and gear of the plain ones (assumed).
    **{f"{size}_b001": f"{size}_m001" for size in Y_SIZES},
    **{f"{size}_a{gear}": f"{size}_r{gear}" for size in Y_SIZES for gear in ("051", "099")},
}
USUAL = "xm430_w350"


def motor_figures(table: ControlTable) -> MotorFigures:
    """Return the figures of a model, else of the nearest model."""
    name = base(table.stem)
    return FIGURES[name if name in FIGURES else _nearest(name)]


def stand_in(table: ControlTable) -> str | None:
    """Return the model whose figures stand for those of this one; None: it has its own."""
    name = base(table.stem)
    return None if name in FIGURES else _nearest(name).upper().replace("_", "-")


def _nearest(name: str) -> str:
    return NEAREST.get(name, USUAL)
