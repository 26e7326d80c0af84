"""`twindctl follow`: goals of a follower from the readings of a leader."""
