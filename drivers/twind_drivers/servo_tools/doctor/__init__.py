"""Doctor of serial servos: inspections of their buses, with the rows of their findings."""
