"""The daemon as its clients and its servos see it, in random order: histories, invariants, their proof."""
