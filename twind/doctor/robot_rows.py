"""The complaints about buses, servos and CAN actuators: rows of the doctor's table, in order of cause."""

from twind.doctor import bus_rows, can_rows, servo_rows
from twind.doctor.check import Check

ROWS: tuple[Check, ...] = (*bus_rows.ROWS, *servo_rows.ROWS, *can_rows.ROWS)
