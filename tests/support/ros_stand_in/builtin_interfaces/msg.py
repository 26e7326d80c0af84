"""Types of the stand-in."""

from stand_in_messages import message

Time = message("builtin_interfaces/msg/Time")
Duration = message("builtin_interfaces/msg/Duration")
