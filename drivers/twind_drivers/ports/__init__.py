"""Ports of every family: serial ports and CAN channels."""
