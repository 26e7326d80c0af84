"""Monitor of a bus of servos with packets of the first protocol."""
