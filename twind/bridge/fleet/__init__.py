"""Fleet: many robots from one place, local instances and those with an uplink."""
