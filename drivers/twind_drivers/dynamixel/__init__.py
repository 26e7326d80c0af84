"""Dynamixel Protocol 2.0: packet codec, control tables, bus, cycle budget."""
