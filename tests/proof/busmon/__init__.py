"""The independent bus monitor: judges every byte between daemon and servos against W1-W11.

Shares no line of code with what it watches: written from the protocol's text, with its own CRC, its own
stuffing and its own reading of the limits.
"""
