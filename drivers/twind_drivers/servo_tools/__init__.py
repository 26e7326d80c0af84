"""Scan, adoption and diagnosis of serial servos, for every family that describes its servos to them."""
