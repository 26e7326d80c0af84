"""Python client of the control socket. Standard library only.

with Client() as robot:
    robot.call("AcquireLease")
    for step in robot.stream("SubmitTrajectory", trajectory=path):
        print(step["phase"], step["progress"])
"""

from twind.client.connection import Client, first_open
from twind.client.errors import (
    CallError,
    ClientError,
    Disconnected,
    MotionFailed,
    NoAnswer,
    NoDaemon,
    NotCarried,
    Refused,
)
from twind.client.find_socket import socket_path

__all__ = [
    "CallError",
    "Client",
    "ClientError",
    "Disconnected",
    "MotionFailed",
    "NoAnswer",
    "NoDaemon",
    "NotCarried",
    "Refused",
    "first_open",
    "socket_path",
]
