"""The same for a CAN bus behind an slcan adapter: text in both directions, four families of actuators.

Written from `facts/can.md` and the vendors' frames alone; shares no line with the drivers.
"""
