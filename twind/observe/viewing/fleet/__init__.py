"""Several robots on one page: who they are (`company`), how they are (`standing`), where they stand
(`stand`), who stops them (`chorus`)."""

from twind.observe.viewing.fleet.fleet_viewer import watch

__all__ = ["watch"]
