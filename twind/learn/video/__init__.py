"""Videos of recordings and of simulated drives, drawn without a display."""
