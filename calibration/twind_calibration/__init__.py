"""Calibration procedures, clients of the running daemon."""
