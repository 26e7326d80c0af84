"""Program `twind-virtual`: a robot file, its physics and virtual servos on pseudo-terminals."""
