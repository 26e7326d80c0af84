"""Soft torque (DAMP): applied to a robot that cannot be lowered, before its torque goes off.

Writes RAM registers only, of servos whose goals are positions. The cap of the output comes first and the
gains follow in the same system call. A servo that receives only part of it is weaker than before, never
stronger. Values come from the gains of the robot file: P becomes an eighth, I becomes 0, D becomes the former
P. The back-EMF of a driven motor brakes too. Not verified on hardware.
"""

from collections.abc import Iterable, Mapping

from twind_drivers.bus import DeviceRefused, GroupWriteBatch, NoReply, Script
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.servo_command_settings import Rows, ServoCommandSettings, groups, rows, writes
from twind_drivers.half_duplex.soft_gain import soft_gain

SHARE = 0.3  # share of the output, or of the current cap in mode 5, that is left; 1 would not sink slowly
ORDERS = 2  # times that the order is sent to a servo that does not confirm it


def damp(
    reader: DynamixelReader, servos: Iterable[ServoCommandSettings], pwm: Mapping[int, int]
) -> Script[tuple[int, ...]]:
    """Make the servos soft; return the ids of those that did not confirm it. A silent servo raises nothing.

    Who does not confirm it gets the order again: it has no reply, and one packet may be lost. `pwm`: PWM
    limit by id, counts.
    """
    stiff = [servo for servo in servos if not servo.mode.rests_at_zero]
    for _ in range(ORDERS):
        caps = rows(stiff, lambda servo: (servo.register_span(servo.capped_by), cap_of(servo, pwm)))
        gains = rows(stiff, lambda servo: (servo.layout.gains, soft(servo)))
        if stiff:
            yield GroupWriteBatch((*writes(caps), *writes(gains)))
        bad: set[int] = set()
        for wanted in (caps, gains):
            bad |= yield from _differing(reader, wanted)
        stiff = [servo for servo in stiff if servo.id in bad]
    return tuple(sorted(servo.id for servo in stiff))


def cap_of(servo: ServoCommandSettings, pwm: Mapping[int, int]) -> bytes:
    """Return the softened output cap of one servo as little-endian register bytes.

    It is `SHARE` of the present cap (or of the PWM limit in `pwm`), at least 1 and never raised. The register
    is goal PWM or, in mode 5, goal current.
    """
    whole = pwm[servo.id] if servo.cap is None else servo.cap
    return min(whole, max(1, int(SHARE * whole))).to_bytes(2, "little", signed=True)


def soft(servo: ServoCommandSettings) -> bytes:
    """Return the softened gains D, I, P of one servo as they lie in its registers.

    The gains of a Y have units of their own, so its D stays.
    """
    field = servo.table["position_d_gain"]
    size = field.size
    d, _, p = (int.from_bytes(servo.gains[at : at + size], "little") for at in (0, size, 2 * size))
    braked = d if servo.table.facts.gear else min(field.bounds[1], max(d, p))
    parts = (braked, 0, soft_gain(p))
    return b"".join(part.to_bytes(size, "little") for part in parts)


def _differing(reader: DynamixelReader, wanted: Rows) -> Script[set[int]]:
    """Return the ids whose read-back differs from `wanted`, silent and refusing devices included."""
    bad: set[int] = set()
    for where, own in groups(wanted).items():
        left = list(own)
        while left:
            try:
                found = yield from reader.collect(left, where.address, where.size)
            except NoReply as error:
                gone = set(error.ids)
            except DeviceRefused as error:
                gone = {error.id}
            else:
                bad |= {id for id, data in found.items() if data != own[id]}
                break
            bad |= gone
            left = [id for id in left if id not in gone]
    return bad
