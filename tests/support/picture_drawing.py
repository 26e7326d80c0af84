"""Drawing of the monitor's picture as SVG, for the pictures of the documents."""

from io import StringIO

from rich.console import Console
from rich.text import Text

from twind.ctl.dashboard.dashboard_layout import picture
from twind.ctl.dashboard.dashboard_renderer import STYLES
from twind.ctl.dashboard.dashboard_state import DashboardState


def svg(view: DashboardState, *, title: str, width: int, height: int) -> str:
    """The picture as a drawing of a terminal, the same for the same view."""
    console = Console(
        record=True, width=width, file=StringIO(), force_terminal=True, color_system="truecolor", _environ={}
    )
    for row in picture(view, width, height, None, view.now):
        console.print(Text.assemble(*((text, STYLES[style]) for text, style in row)), no_wrap=True, crop=True)
    return console.export_svg(title=title, unique_id="twind-monitor")
