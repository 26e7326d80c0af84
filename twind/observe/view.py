"""View the twin in a browser, with a stop and an e-stop button.

Shows the robot as measured, its goals as a translucent figure, contacts and distances, plots and text. The
viewer is a client: ending or killing it changes nothing. It prints its address, which contains a secret.
"""

import argparse
from importlib.util import find_spec

from twind.command_line.extras import how_to_add
from twind.command_line.verb import UsageError

group = "see"

NEEDED = ("viser", "mjviser")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument(
        "--port", type=int, metavar="N", help="of 127.0.0.1 (default: the first free one from 8099)"
    )
    parser.add_argument("--open", action="store_true", help="open the page in your browser")
    parser.add_argument("--wait", action="store_true", help="begin though no daemon is there yet")
    parser.add_argument(
        "--operate",
        action="store_true",
        help="the page may also take the lease, arm, disarm and play motions (default: look, stop, e-stop)",
    )


def run(options: argparse.Namespace) -> int:
    """Until Ctrl-C or SIGTERM: 0. Raises UsageError, Rejected, ClientError."""
    needed(options.port)
    from twind.observe.viewing import watch

    return watch(
        options.socket,
        port=options.port,
        open_page=options.open,
        operate=options.operate,
        wait=options.wait,
        as_json=options.json,
    )


def needed(port: int | None = None) -> None:
    """Raises UsageError: what draws is not installed, or `port` is none."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise UsageError(f"the viewer needs {' and '.join(missing)}: {how_to_add('view')}")
    if port is not None and not 1 <= port <= 65535:
        raise UsageError(f"--port {port} is no port: 1 to 65535")
