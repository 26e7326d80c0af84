"""Hiwonder LX-16A bus servos: an example of a driver family that is no part of twind."""
