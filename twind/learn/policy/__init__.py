"""Policies: their files, and `twindctl policy`, which lets one drive a robot as an ordinary client."""
