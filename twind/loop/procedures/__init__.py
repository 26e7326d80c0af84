"""Procedures of the loop: work over several ticks, such as arming, release and identification."""
