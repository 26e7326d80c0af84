"""How a recording is written: a client of the daemon, its files and their folder."""
