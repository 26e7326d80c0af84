"""Checks of the doctor that only servos of protocol 2.0 have."""
