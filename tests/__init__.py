"""Tests by room, their helpers in `support`, and whole programs in `proof`."""
