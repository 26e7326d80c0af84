"""Adoption of a new serial servo: search, register plan, writes. Opens the port exclusively."""
