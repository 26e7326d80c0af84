"""The figures of a daemon, as OpenMetrics has them."""
