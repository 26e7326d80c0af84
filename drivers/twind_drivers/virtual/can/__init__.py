"""Virtual CAN actuators: nodes of four families on one wire, behind an adapter of frames or slcan text.

Written a second time, from the vendors' frames, and not by our own codecs: a mistake in those shows here.
"""
