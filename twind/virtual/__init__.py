"""`twind-virtual`: a robot file, muscles and virtual servos on pseudo-terminals."""
