"""Readings of a robot, sent to an HTTP endpoint while they happen: `twindctl stream`.

A client of observe.sock. Standard library, numpy and msgspec: none of the learning extras.
"""
