"""Virtual devices that speak the real protocols: registers, wire timing, faults, muscles in raw units."""
