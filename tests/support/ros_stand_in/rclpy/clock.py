"""The wall clock."""

import time

from builtin_interfaces.msg import Time as Message


class Time:
    def __init__(self, *, nanoseconds=0):
        self.nanoseconds = nanoseconds

    def to_msg(self):
        sec, nanosec = divmod(self.nanoseconds, 10**9)
        return Message(sec=sec, nanosec=nanosec)


class Clock:
    def now(self):
        return Time(nanoseconds=time.time_ns())
