"""Types of the stand-in."""

from stand_in_messages import service

Trigger = service("std_srvs/srv/Trigger")
SetBool = service("std_srvs/srv/SetBool")
