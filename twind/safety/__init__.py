"""Checks between commands and motors: gate, guard, states, lease. Pure: no I/O, no clock, no globals."""
