"""A new serial servo becomes a joint's: who it is, what it must be told, telling it. Port opened alone."""
