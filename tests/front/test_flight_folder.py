"""Flight files have names of their own, the newest are kept, and one crash is written down once."""

import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.loop_stand_in import briefing
from twind.flight import PackedFlight, about, load
from twind.front.flight_folder import APART, CRASH, LEFT, FlightFolder, meta_of, plain

EMPTY = PackedFlight({}, b"")


def meta(at: float = 1_800_000_000.0, **more: Any) -> dict[str, Any]:
    """Metadata of a file written at the time `at` (s since 1970)."""
    return meta_of(briefing(1), "dump", "DUMP") | {"wall_ns": round(at * 1e9)} | more


def write(folder: FlightFolder, label: str = "DUMP", at: float = 1_800_000_000.0, **more: Any) -> Path | None:
    path = folder.write(label, meta(at, **more), plain(briefing(1)), EMPTY)
    if path is not None:
        os.utime(path, (at, at))
    return path


def no_space(_fd: int) -> None:
    raise OSError(28, "No space left on device")


def test_a_file_is_named_by_its_time_and_code(tmp_path: Path) -> None:
    folder = FlightFolder(tmp_path / "state" / "flight")
    assert (
        write(folder, "OVERHEAT", 1_795_364_100.0) == folder.path / "flight-20261122T161500Z-OVERHEAT.flight"
    )
    assert stat.S_IMODE(folder.path.stat().st_mode) & 0o027 == 0
    assert stat.S_IMODE(next(folder.path.iterdir()).stat().st_mode) & 0o137 == 0


def test_two_of_one_second_are_two_files(tmp_path: Path) -> None:
    names = [path.name for _ in range(3) if (path := write(FlightFolder(tmp_path))) is not None]
    assert len(set(names)) == len(os.listdir(tmp_path)) == 3
    assert all(load(tmp_path / name).contents.entries == () for name in names)


def test_the_newest_are_kept_by_number_and_by_size(tmp_path: Path) -> None:
    (tmp_path / "mine.flight").write_text("renamed by its owner")
    for number in range(6):
        write(FlightFolder(tmp_path, kept=4), f"N{number}", 1_800_000_000.0 + number)
    assert sorted(path.name[24:-7] for path in tmp_path.glob("flight-*")) == ["N2", "N3", "N4", "N5"]
    size = (tmp_path / os.listdir(tmp_path)[0]).stat().st_size
    write(FlightFolder(tmp_path, most=max(size, 2000)), "LAST", 1_800_000_100.0)
    left = sorted(path.name[24:-7] for path in tmp_path.glob("flight-*"))
    assert left[0] == "LAST" and len(left) < 5
    write(FlightFolder(tmp_path, most=1), "ONLY", 1_800_000_200.0)
    assert [path.name[24:-7] for path in tmp_path.glob("flight-*")] == ["ONLY"]
    assert (tmp_path / "mine.flight").exists()


def test_a_clock_that_went_back_costs_no_new_file(tmp_path: Path) -> None:
    for number in range(3):
        write(FlightFolder(tmp_path, kept=2), f"LATER{number}", 1_800_000_000.0 + number)
    path = write(FlightFolder(tmp_path, kept=2), "NOW", 3600.0)
    assert path is not None and path.exists()
    crash = {"reason": "crash"}
    assert write(FlightFolder(tmp_path), CRASH, 1_800_000_000.0, **crash) is not None
    assert write(FlightFolder(tmp_path), CRASH, 3600.0, **crash) is not None


def test_an_old_unfinished_file_is_removed(tmp_path: Path) -> None:
    for name, age in ((".flight-old.flight.tmp", LEFT + 10.0), (".flight-new.flight.tmp", 0.0)):
        (tmp_path / name).write_text("half")
        now = (tmp_path / name).stat().st_mtime - age
        os.utime(tmp_path / name, (now, now))
    write(FlightFolder(tmp_path))
    assert [name for name in os.listdir(tmp_path) if name.startswith(".")] == [".flight-new.flight.tmp"]


def test_a_crash_of_the_same_robot_within_a_minute_is_not_written_again(tmp_path: Path) -> None:
    folder = FlightFolder(tmp_path)
    at = 1_800_000_000.0
    crash = {"reason": "crash"}
    assert write(folder, CRASH, at, **crash) is not None
    assert write(folder, CRASH, at + APART - 1.0, **crash) is None
    assert write(folder, CRASH, at + 1.0, **crash, individual="another") is not None
    assert write(folder, CRASH, at + APART + 1.0, **crash) is not None
    (tmp_path / f"flight-x-{CRASH}.flight").write_text("no flight file")
    assert write(folder, CRASH, at + 3 * APART, **crash) is not None


def test_a_dump_that_is_called_so_hides_no_crash_and_no_other_dump(tmp_path: Path) -> None:
    folder = FlightFolder(tmp_path)
    assert write(folder, CRASH) is not None
    assert write(folder, CRASH) is not None
    assert write(folder, CRASH, reason="crash") is not None


KILLED = """
import os, signal, sys, zlib
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.front.test_flight_folder import FlightFolder, write
zlib.compress = lambda data, level: os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[3] == "written":
    import twind.flight.flight_file as file
    zlib.compress = lambda data, level: data
    os.fsync = lambda fd: os.kill(os.getpid(), signal.SIGKILL)
write(FlightFolder(Path(sys.argv[1])), "CRASH", reason="crash")
"""


@pytest.mark.parametrize("at", ["packed", "written"])
def test_a_writer_that_is_killed_leaves_nothing_that_counts_as_a_file(tmp_path: Path, at: str) -> None:
    folder = FlightFolder(tmp_path / "flight", kept=1)
    first = write(folder, "FIRST")
    assert first is not None
    command = [sys.executable, "-c", KILLED, str(folder.path), str(Path(__file__).parents[2]), at]
    assert subprocess.run(command, timeout=60.0, check=False).returncode == -9
    assert list(folder.path.glob("flight-*")) == [first]
    assert write(folder, CRASH, reason="crash") is not None


def test_a_disk_that_what_was_left_here_fills_is_cleared_before_it_is_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        write(FlightFolder(tmp_path), f"N{number}", 1_800_000_000.0 + number)
    (tmp_path / ".flight-old-CRASH-7.tmp").write_text("half")
    os.utime(tmp_path / ".flight-old-CRASH-7.tmp", (0, 0))

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space"):
        write(FlightFolder(tmp_path, kept=2), "NEW", 1_800_000_100.0)
    assert sorted(os.listdir(tmp_path)) == [
        f"flight-20270115T08000{number}Z-N{number}.flight" for number in (1, 2)
    ]


def test_a_failed_write_leaves_no_file_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space"):
        write(FlightFolder(tmp_path))
    assert os.listdir(tmp_path) == []


def test_nothing_that_must_be_unpickled_is_in_a_file(tmp_path: Path) -> None:
    told = briefing()
    assert told.binding
    FlightFolder(tmp_path).write("DUMP", meta(), plain(told), EMPTY)
    path = tmp_path / os.listdir(tmp_path)[0]
    assert load(path).briefing.binding == load(path).briefing.described == b""
    assert load(path).briefing.joints == told.joints
    assert about(path)["code"] == "DUMP"
