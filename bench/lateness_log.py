"""The daemon with every tick's lateness kept: `python -m bench.lateness_log FILE ARGUMENT…`.

The daemon itself publishes the quantiles of its whole run only, start included; a figure needs those of its
own seconds. Everything else is `twind.cli` as it stands.
"""

import mmap
import struct
import sys
from pathlib import Path

from twind import cli
from twind.loop.tick import control_loop
from twind.loop.tick.loop_figures import LoopFigures

TICKS = 1 << 17  # room for 20 minutes at 100 Hz
HEADER = struct.Struct("<Q")
ROW = struct.Struct("<d")


class LatenessLog:
    """Lateness of ticks in a mapped file: a count, then one float64 (s) per tick."""

    def __init__(self, path: Path, *, create: bool = False) -> None:
        if create:
            path.write_bytes(bytes(HEADER.size + ROW.size * TICKS))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)

    def __len__(self) -> int:
        return int(HEADER.unpack_from(self._map)[0])

    def add(self, lateness: float) -> None:
        """One tick; those beyond the room are not kept."""
        count = len(self)
        if count < TICKS:
            ROW.pack_into(self._map, HEADER.size + ROW.size * count, lateness)
            HEADER.pack_into(self._map, 0, count + 1)

    def since(self, start: int) -> list[float]:
        """Lateness (s) of the ticks from number `start` on."""
        return [ROW.unpack_from(self._map, HEADER.size + ROW.size * i)[0] for i in range(start, len(self))]


def recorded(kept: LatenessLog) -> type[LoopFigures]:
    """Statistics of a loop that also keep the lateness of each tick."""

    class RecordedLoopFigures(LoopFigures):
        def tick(self, missed: int) -> None:
            kept.add(self.lateness)
            super().tick(missed)

    return RecordedLoopFigures


def main() -> int:
    """Run the daemon, recorded."""
    control_loop.LoopFigures = recorded(LatenessLog(Path(sys.argv[1]), create=True))  # type: ignore[misc]
    return cli.main(sys.argv[2:])


if __name__ == "__main__":
    sys.exit(main())
