"""A small daemon that does everything right, and many that are it with one thing done wrong.

They prove the monitor: the right one passes, each wrong one is caught by the rule that it breaks.
"""
