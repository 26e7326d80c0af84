"""Feetech serial servos: STS, SMS, SCS and HLS."""
