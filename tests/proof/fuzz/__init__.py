"""Inputs nobody should send: to the wire parser, to a real front, to the readers of files. `make fuzz`."""
