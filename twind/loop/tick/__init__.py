"""The tick of the loop: its state, what the guard is given, reactions and reports."""
