"""Types of the stand-in."""

from stand_in_messages import message

SetParametersResult = message("rcl_interfaces/msg/SetParametersResult")
Parameter = message("rcl_interfaces/msg/Parameter")
ParameterValue = message("rcl_interfaces/msg/ParameterValue")
