"""Helpers shared by the computed and the real-time tests of dynamixel reader."""

from tests.support.dynamixel_responder import Servos


def pose(servos: Servos) -> None:
    for id in servos.memory:
        servos.put(id, 126, -id, 2)
        servos.put(id, 128, -1000 * id, 4)
        servos.put(id, 132, 100_000 - id, 4)
