"""Writing of recordings: a client of the daemon, its files and their folder."""
