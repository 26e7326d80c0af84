"""Types of the stand-in."""

from stand_in_messages import service

SetParameters = service("rcl_interfaces/srv/SetParameters")
GetParameters = service("rcl_interfaces/srv/GetParameters")
