"""`twindctl`: everything a person or a script asks of the daemon."""
