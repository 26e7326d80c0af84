"""Virtual CAN actuators: nodes of four families on one wire, behind an adapter of frames or slcan text.

They are written independently, from the vendors' frames: an error of the driver's codecs shows here.
"""
