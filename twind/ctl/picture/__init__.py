"""The live picture of a robot: what was told (`view`), its lines (`layout`), a terminal (`live`)."""
