"""Gains of a servo type from the step responses of its joints: figures, search, order of the tries."""
