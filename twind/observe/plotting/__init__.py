"""A recording as one page for reports."""
