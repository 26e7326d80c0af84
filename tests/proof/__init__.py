"""Programs that prove safety and correctness at length."""
