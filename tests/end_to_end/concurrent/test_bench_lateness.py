"""The daemon of the lateness figures runs as any other, and keeps the lateness of each of its ticks."""

from pathlib import Path

from bench.daemon import twind
from bench.lateness_log import LatenessLog
from tests.support.processes import until


def test_each_tick_is_kept(tmp_path: Path) -> None:
    record = tmp_path / "lateness"
    with twind(tmp_path, "--mode", "sim", command=("-m", "bench.lateness_log", str(record))) as daemon:
        until(lambda: len(LatenessLog(record)) > 50, 30.0, "ticks are kept")
        with daemon.client() as client:
            ticks = client.call("GetStatus")["status"]["loop"]["ticks"]
        kept = LatenessLog(record)
        assert len(kept) >= ticks
    assert all(late >= 0.0 for late in kept.since(0))
