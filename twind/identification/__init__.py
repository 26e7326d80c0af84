"""Identification: parameters of joints, servos and links from recorded motion, with their uncertainty.

Runs on a desk or beside the daemon, never in it.
"""
