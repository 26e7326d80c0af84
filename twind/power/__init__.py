"""Supply relay and stop button: a small process of their own, which outlives the loop. Standard library."""
