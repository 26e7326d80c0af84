"""Buses, the ways of readings and commands, and how late ticks began. Pure."""

from collections.abc import Sequence
from math import log

from twind.ctl.dashboard.dashboard_blocks import DashboardBlock, DashboardRow, micro, milli, titled
from twind.ctl.dashboard.dashboard_state import Answer, DashboardState
from twind.ctl.dashboard.styled_lines import Line, Span, align_left, cut, line, right

FULL = 0.9  # share of the tick from which a bus is worth a look
LATE = 2.0  # ms: a tick that begins later is reported (LOOP_LATE)
BARS = 8  # rows of a histogram at most
SLOW = 0.9  # of the loop's rate: a bus that is exchanged less often is worth a look
_HEADS = ("bus", "port", "", "a second", "ms", "p99", "wire", "errors")
_HOPS = ("now", "mean", "dev", "min", "max", "p50", "p99")


def buses(view: DashboardState, width: int) -> DashboardBlock:
    """Connected, how often, errors, share of the wire, how long an exchange takes."""
    status = view.status
    if status is None or not status["buses"]:
        return DashboardBlock("buses", (), (), 0)
    names = min(12, max(3, *(len(bus["name"]) for bus in status["buses"])))
    sizes = (names, max(10, min(24, width - names - 55)), 13)
    rate = status["loop"]["rate_hz"] if status["mode"] != "sim" else 0.0
    rows = [_bus(bus, view.rates.get(bus["name"]), rate, sizes, width) for bus in status["buses"]]
    start = "  ".join(align_left(title, size) for title, size in zip(_HEADS[:3], sizes, strict=True))
    head = start + "".join(
        right(title, size) for title, size in zip(_HEADS[3:], (9, 6, 6, 6, 9), strict=True)
    )
    return DashboardBlock("buses", (cut(line((head, "dim")), width),), rows, min(1 + len(rows), 3))


def _bus(bus: Answer, rate: float | None, wanted: float, sizes: Sequence[int], width: int) -> DashboardRow:
    on = bus["connected"]
    warned = bool(bus.get("warning"))
    slow = on and rate is not None and rate < SLOW * wanted
    full = bus["utilisation"] >= FULL
    connected: Span = (
        ("connected", "") if on else ("NOT CONNECTED", "bad") if wanted else ("not opened", "dim")
    )
    spans: list[Span] = [
        (align_left(bus["name"], sizes[0]) + "  ", ""),
        (align_left(bus["port"] or "no port", sizes[1]) + "  ", ""),
        (align_left(connected[0], sizes[2]), connected[1]),
        (right(f"{'! ' if slow else ''}{micro(rate)}", 9), "warn" if slow else ""),
        (right(milli(bus["latency_ms"]), 6), ""),
        (right(milli(bus["latency_p99_ms"]), 6), ""),
        (right(f"{'!' if full else ''}{bus['utilisation']:.0%}", 6), "warn" if full else ""),
        (right(str(bus["errors"]), 9), "warn" if bus["errors"] else ""),
    ]
    if warned:
        spans.append((" !", "warn"))
    return DashboardRow(cut(line(*spans), width), urgent=(not on and wanted > 0.0) or slow or warned)


def hops(view: DashboardState, width: int) -> DashboardBlock:
    """Each step of a reading and of a command, ms; last, how many of the last 100 took too long."""
    if not view.hops:
        return DashboardBlock("hops", (), (), 0)
    head = line((f"  {align_left('ms', 10)}{''.join(right(each, 7) for each in _HOPS)}  too long", "dim"))
    title = titled("latency, hop by hop", width)
    return DashboardBlock(
        "hops", (title, cut(head, width)), [_hop(hop, width) for hop in view.hops], min(5, 2 + len(view.hops))
    )


def _hop(hop: Answer, width: int) -> DashboardRow:
    keys = ("now_ms", "mean_ms", "std_ms", "min_ms", "max_ms", "p50_ms", "p99_ms")
    numbers = "".join(right(milli(hop[key], 2), 7) for key in keys)
    count = hop["violations"]
    said: Span = (right(str(count), 10), "warn" if count else "dim")
    mark: Span = ("! ", "warn") if count else ("  ", "")
    return DashboardRow(cut(line(mark, align_left(hop["hop"], 10), numbers, said), width), urgent=bool(count))


def lateness(view: DashboardState, width: int) -> DashboardBlock:
    """Lateness of ticks in the whole run: a bar per bucket, logarithmic, so that a single tick is visible."""
    buckets = merged(view.lateness, BARS)
    if not buckets:
        return DashboardBlock("lateness", (), (), 0)
    total = sum(count for _, count in buckets)
    most = max(count for _, count in buckets)
    size = max(4, min(40, width - 36))
    rows = [
        _bar(upper, count, count / total, log(1 + count) / log(1 + most), size) for upper, count in buckets
    ]
    title = titled("ticks began late by", width)
    return DashboardBlock(
        "lateness", (title,), [DashboardRow(cut(each, width)) for each in rows], 1 + len(rows)
    )


def _bar(upper: float | None, count: int, share: float, long: float, size: int) -> Line:
    late = count and (upper is None or upper > LATE)
    bound = "longer, unknown" if upper is None else f"up to {upper:.3g} ms"
    bar = "█" * round(long * size) or ("▏" if count else "")
    sign = " !" if late else ""
    return line(
        (right(bound, 16) + " ", "dim"),
        (align_left(bar, size), "warn" if late else "good"),
        f" {share:8.3%}",
        (f" {count}{sign}", "warn" if late else "dim"),
    )


def merged(buckets: Sequence[Answer], most: int) -> list[tuple[float | None, int]]:
    """Upper bound (ms, None: none) and count of at most `most` rows: empty ends out, neighbours joined."""
    rows = [(bucket["upper_ms"], int(bucket["count"])) for bucket in buckets]
    used = [place for place, (_, count) in enumerate(rows) if count]
    if not used:
        return []
    rows = rows[used[0] : used[-1] + 1]
    step = -(-len(rows) // most)
    groups = [rows[place : place + step] for place in range(0, len(rows), step)]
    return [(group[-1][0], sum(count for _, count in group)) for group in groups]
