"""`python -m bench [PREFIX]`: take the figures whose key begins with PREFIX, print them, keep them.

Writes `results.json` beside this file. `--docs` also puts the table of all kept figures into `docs/bench.md`.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

from bench import (
    bus,
    busy,
    can,
    can_bus,
    can_loop,
    control,
    ctl,
    fleet,
    gate,
    hot_tick,
    learn,
    loop,
    loop_on_c_servos,
    observe,
    record,
    ros,
    ros_zenoh,
    small,
    start,
    stream,
    twin,
    view,
    virtual_hour,
)
from bench.base_commit import BASE
from bench.busy import MINUTES
from bench.harness import (
    RESULTS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    save,
    table,
)
from bench.machine import describe

MEASUREMENTS: tuple[Measurement, ...] = (
    *bus.MEASUREMENTS,
    *can.MEASUREMENTS,
    *can_bus.MEASUREMENTS,
    *can_loop.MEASUREMENTS,
    *loop.MEASUREMENTS,
    *hot_tick.MEASUREMENTS,
    *small.MEASUREMENTS,
    *loop_on_c_servos.MEASUREMENTS,
    *virtual_hour.MEASUREMENTS,
    *twin.MEASUREMENTS,
    *gate.MEASUREMENTS,
    *control.MEASUREMENTS,
    *ctl.MEASUREMENTS,
    *start.MEASUREMENTS,
    *observe.MEASUREMENTS,
    *view.MEASUREMENTS,
    *record.MEASUREMENTS,
    *fleet.MEASUREMENTS,
    *ros.MEASUREMENTS,
    *ros_zenoh.MEASUREMENTS,
    *stream.MEASUREMENTS,
    *learn.MEASUREMENTS,
    *busy.MEASUREMENTS,
)
KEYS: dict[str, FigureSpec] = {name: key for one in MEASUREMENTS for name, key in one.keys.items()}
DOCS = Path(__file__).parents[1] / "docs" / "bench.md"
BEGIN = "<!-- figures -->\n"
END = "<!-- end of figures -->\n"


def main() -> int:
    """Exit code 0: taken, or not to be had on this machine; 1: a figure failed; 2: usage."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__.splitlines()[0])
    parser.add_argument("prefix", nargs="?", default="", help="group, or start of a key (default: all)")
    parser.add_argument("--docs", action="store_true", help="put the table of all figures into docs/bench.md")
    parser.add_argument("--base", metavar="COMMIT", help="commit to compare with (default: the last landed)")
    parser.add_argument("--minutes", metavar="N", help="length of `busy` (default: 10, alone 1)")
    options = parser.parse_args()
    for name, value in ((BASE, options.base), (MINUTES, options.minutes or ("" if options.prefix else "10"))):
        if value:
            os.environ[name] = value
    wanted = [one for one in MEASUREMENTS if any(name.startswith(options.prefix) for name in one.keys)]
    if not wanted:
        parser.error(f"no figure begins with {options.prefix!r}; there are {', '.join(KEYS)}")
    found: dict[str, dict[str, object]] = {}
    failed = False
    for one in wanted:
        figures, broke = _take(one)
        failed |= broke
        found |= {name: figures[name].as_json(key.unit) for name, key in one.keys.items()}
        save(found, whole=False)
    save(found, whole=wanted == list(MEASUREMENTS))
    print(describe(), table(found, KEYS), sep="\n\n")
    if options.docs:
        _write_docs()
    return int(failed)


def _take(one: Measurement) -> tuple[dict[str, MeasuredFigure], bool]:
    """The figures of one measurement, whatever happens; whether it broke."""
    names = ", ".join(one.keys)
    since = time.monotonic()
    print(f"taking {names}", file=sys.stderr, flush=True)
    try:
        figures = dict(one.take())
        broke = False
    except MeasurementUnavailable as reason:
        figures = dict.fromkeys(one.keys, MeasuredFigure(None, f"not taken: {reason}"))
        broke = False
    except Exception as error:  # noqa: BLE001 - one broken figure must not lose the others
        figures = dict.fromkeys(one.keys, MeasuredFigure(None, f"failed: {error!r}"))
        broke = True
    for name in one.keys:
        print(f"  {name} = {figures[name].value} {one.keys[name].unit}", file=sys.stderr)
    print(f"  {time.monotonic() - since:.0f} s", file=sys.stderr, flush=True)
    return figures, broke


def _write_docs() -> None:
    """The kept figures, in the order of the list, between the marks of the page."""
    kept = json.loads(RESULTS.read_text())
    rows = {name: kept[name] for name in KEYS if name in kept}
    page = DOCS.read_text()
    before, _, rest = page.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"{DOCS.name}: no place for the figures: {BEGIN.strip()} … {END.strip()}")
    DOCS.write_text(f"{before}{BEGIN}\n{describe()}\n\n{table(rows, KEYS)}\n\n{END}{after}")


if __name__ == "__main__":
    sys.exit(main())
