"""Framework of the verbs of `twindctl`: protocol, options, connections, output. Standard library only."""
