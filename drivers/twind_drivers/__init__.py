"""Actuator drivers: codecs, buses and virtual devices, in ticks and registers. They know no radians."""
