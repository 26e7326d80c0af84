"""The rooms of `twindctl view`: what is shown (`scene`, `page`), who may look (`door`), who may act (`stops`,
`operate`)."""

from twind.observe.viewing.viewer_run import show, watch

__all__ = ["show", "watch"]
