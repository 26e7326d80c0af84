"""Position gain of damping: an eighth of the servo's own, so that a large error demands little output."""

SOFT = 8  # divisor


def soft_gain(gain: int) -> int:
    """Return the P gain of damping; never 0 where there was one: the joint would be limp."""
    return min(gain, max(1, gain // SOFT))
