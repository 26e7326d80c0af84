"""A robot in Python: `twind.Robot` drives it through one daemon, by its lease and its gate."""
