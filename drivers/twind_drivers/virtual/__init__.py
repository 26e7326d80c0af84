"""Virtual servos with the real protocol: registers, rules, wire timing, faults, and their physics."""
