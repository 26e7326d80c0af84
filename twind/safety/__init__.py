"""What may reach a motor: gate, guard, states, lease, health. Pure: no I/O, no clock, no globals."""
