"""Many robots from one place: local instances and those that have an uplink."""
