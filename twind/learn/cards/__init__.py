"""Policies of other frameworks: a card that describes a network, its observer, its actor, and its check."""
