"""Numbers in bit fields of a range, as the vendors' sample code packs and unpacks them. Pure."""

import math


def pack(value: float, span: float, bits: int) -> int:
    """Pack `value` in -span..span into a field of so many bits: cut off, not rounded (CubeMars manual p. 48).

    A value beyond stays at the edge: the field has no other form. Not a number becomes the middle.
    """
    most = (1 << bits) - 1
    if not math.isfinite(value):
        value = 0.0
    if abs(value) >= span:
        return most if value > 0.0 else 0
    return int((value + span) * most / (2.0 * span))


def unpack(raw: int, span: float, bits: int) -> float:
    """-span..span of a field."""
    return raw * 2.0 * span / ((1 << bits) - 1) - span


def fraction(raw: int, span: float, bits: int) -> float:
    """0..span of a field: gains."""
    return raw * span / ((1 << bits) - 1)


def mit_command(data: bytes, spans: tuple[float, float, float]) -> tuple[float, float, float, float, float]:
    """Place rad, speed rad/s, stiffness N·m/rad, damping N·m·s/rad, torque N·m of 8 bytes.

    Position 16 bits, then velocity, Kp, Kd and torque 12 each, the highest first (CubeMars manual V1.0.8
    p. 48-49; RobStride SampleProgram). Kp is 0..500, Kd 0..5 in all of the family. `spans` as of a node.
    """
    whole = int.from_bytes(data, "big")
    position, velocity, torque = spans
    return (
        unpack(whole >> 48, position, 16),
        unpack(whole >> 36 & 0xFFF, velocity, 12),
        fraction(whole >> 24 & 0xFFF, 500.0, 12),
        fraction(whole >> 12 & 0xFFF, 5.0, 12),
        unpack(whole & 0xFFF, torque, 12),
    )


def mit_state(position: float, velocity: float, torque: float, spans: tuple[float, float, float]) -> bytes:
    """5 bytes of a reply: position 16 bits, velocity and torque (CubeMars: current) 12 each."""
    whole = (
        pack(position, spans[0], 16) << 24 | pack(velocity, spans[1], 12) << 12 | pack(torque, spans[2], 12)
    )
    return whole.to_bytes(5, "big")
