"""Virtual servos that speak the real protocol: registers, rules, wire timing, faults; and their muscles."""
