"""A running twind as learners and policies have it: setpoints through the gate, and an estimated base."""
