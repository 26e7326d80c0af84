"""Types of the stand-in."""

from stand_in_messages import message

DiagnosticArray = message("diagnostic_msgs/msg/DiagnosticArray")
