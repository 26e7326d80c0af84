"""What a robot does, sent to an HTTP endpoint while it happens: `twindctl stream`, `twindctl ingest`.

A client of observe.sock. Standard library, numpy and msgspec: none of the learning extras.
"""
