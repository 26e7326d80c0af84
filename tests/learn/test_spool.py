"""The spool: in order, once, within its bounds, whatever is appended, sent, refused or cut off by a crash."""

import resource
import shutil
import signal
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.spool_rig import WIDE, carrying, folder
from twind.exceptions import OperationFailed
from twind.learn.streaming.spool import BROKEN, FILE, Spool, SpoolLimits, dead_letters
from twind.learn.streaming.stream_samples import PostMessage


@pytest.fixture
def place() -> Iterator[Path]:
    with folder() as found:
        yield found


def waiting(spool: Spool) -> list[int]:
    found = []
    after = 0
    while (kept := spool.oldest(after)) is not None:
        found.append(after := kept.sequence)
    return found


# ------------------------------------------------------------------------------------------ any interleaving

BOUNDS = SpoolLimits(bytes=60, age=50.0)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("append"), st.integers(0, 40)),
        st.tuples(st.sampled_from(["arrives", "dies", "lost answer", "revive", "crash", "end"]), st.just(0)),
        st.tuples(st.just("time"), st.integers(1, 40)),
    ),
    max_size=25,
)


@dataclass(slots=True)
class Model:
    """Expected content of a spool: sequence -> (body, when, dead)."""

    rows: dict[int, tuple[bytes, float, bool]] = field(default_factory=dict)
    given: dict[int, bytes] = field(default_factory=dict)  # every number that ever was
    sent: int = 0
    now: float = 1000.0

    def fit(self) -> None:
        """The oldest goes first."""
        for sequence in sorted(self.rows):
            made = self.rows[sequence][1]
            if (
                self.now - made <= BOUNDS.age
                and sum(len(b) for b, _, _ in self.rows.values()) <= BOUNDS.bytes
            ):
                return
            del self.rows[sequence]


@examples(120)
@given(STEPS)
def test_acknowledged_messages_are_removed_and_others_are_sent_again_in_order_within_bounds(
    steps: list[tuple[str, int]],
) -> None:
    with folder() as at:
        model = Model()
        crashes = 0
        spool = Spool(at, BOUNDS, model.now, model.now)
        stream = spool.tally.stream
        for number, (what, size) in enumerate(steps):
            first = spool.oldest()
            if what == "append":
                body = bytes([number]) * size
                sequence = spool.append(PostMessage(body, {}), model.now, model.now)
                assert sequence not in model.given, "a number came again"
                assert sequence > max(model.given, default=0)
                model.given[sequence] = body
                model.rows[sequence] = (body, model.now, False)
                model.fit()
            elif what == "arrives" and first is not None:
                spool.acknowledge(first.sequence)
                del model.rows[first.sequence]
                model.sent += 1
            elif what == "dies" and first is not None:
                spool.bury(first.sequence, "no")
                model.rows[first.sequence] = (*model.rows[first.sequence][:2], True)
            elif what == "revive":
                spool.revive()
                model.rows = {key: (*row[:2], False) for key, row in model.rows.items()}
            elif what == "time":
                model.now += size
                spool.expire(model.now, model.now)
                model.fit()
            elif what in ("crash", "end"):
                crashes += 1
                again = at.with_name(f"again{crashes}")
                if what == "crash":  # the files as SIGKILL leaves them
                    shutil.copytree(at, again)
                    spool.close()
                else:
                    spool.close()
                    shutil.copytree(at, again)
                at = again
                spool = Spool(at, BOUNDS, model.now, model.now)
            alive = [sequence for sequence, (_, _, dead) in sorted(model.rows.items()) if not dead]
            assert waiting(spool) == alive
            for kept in filter(None, [spool.oldest()]):
                assert kept.message.body == model.given[kept.sequence], "a key has other data"
            told = spool.tally
            assert told.stream == stream
            assert (told.sent, told.waiting, told.dead) == (
                model.sent,
                len(alive),
                len(model.rows) - len(alive),
            )
            assert told.sent + told.waiting + told.dead + told.dropped == len(model.given)
            assert told.bytes == sum(len(body) for body, _, _ in model.rows.values()) <= BOUNDS.bytes
        spool.close()


# ------------------------------------------------------------------------------------------ each by itself


def test_a_message_comes_back_as_it_was(place: Path) -> None:
    with Spool(place, WIDE, 0.0, 100.0) as spool:
        sequence = spool.append(
            PostMessage(b"\x00\xff", {"Content-Type": "image/jpeg", "Twind-Camera": "x"}, 7), 0.0, 100.0
        )
        kept = spool.oldest()
        assert kept is not None
        assert (kept.sequence, kept.wall, kept.reason) == (sequence, 100.0, None)
        assert kept.message == PostMessage(
            b"\x00\xff", {"Content-Type": "image/jpeg", "Twind-Camera": "x"}, 7
        )
        assert spool.oldest(sequence) is None


def test_a_message_dropped_while_it_was_sent_counts_once(place: Path) -> None:
    with Spool(place, SpoolLimits(10, 1e9), 0.0, 0.0) as spool:
        first = spool.append(carrying("12345678"), 0.0, 0.0)
        spool.append(carrying("12345678"), 0.0, 0.0)
        spool.acknowledge(first)
        spool.bury(first, "no")
        assert (spool.tally.sent, spool.tally.dropped, spool.tally.dead, spool.tally.waiting) == (0, 1, 0, 1)


def test_messages_lost_before_the_spool_are_counted_permanently(place: Path) -> None:
    with Spool(place, WIDE, 0.0, 0.0) as spool:
        spool.append(carrying("a"), 0.0, 0.0, lost=3)
    with Spool(place, WIDE, 0.0, 0.0) as spool:
        assert spool.tally.dropped == 3


def test_a_wall_clock_that_is_set_drops_nothing_of_this_run(place: Path) -> None:
    """A board without a clock of its own: it starts in 1970, and NTP comes after a minute."""
    with Spool(place, SpoolLimits(1 << 20, 3600.0), 10.0, 0.0) as spool:
        spool.append(carrying("early"), 10.0, 0.0)
        spool.expire(70.0, 1.8e9)
        assert spool.tally.waiting == 1
        spool.expire(10.0 + 3601.0, 1.8e9)
        assert (spool.tally.waiting, spool.tally.dropped) == (0, 1)


def test_messages_of_an_earlier_run_age_by_the_wall_clock(place: Path) -> None:
    with Spool(place, SpoolLimits(1 << 20, 3600.0), 5000.0, 1e9) as spool:
        spool.append(carrying("old"), 5000.0, 1e9)
    with Spool(place, SpoolLimits(1 << 20, 3600.0), 3.0, 1e9 + 3000.0) as spool:
        assert spool.tally.waiting == 1
    with Spool(place, SpoolLimits(1 << 20, 3600.0), 3.0, 1e9 + 4000.0) as spool:
        assert (spool.tally.waiting, spool.tally.dropped) == (0, 1)


def test_dead_letters_are_listed_while_a_streamer_runs_and_return_to_their_places(place: Path) -> None:
    with Spool(place, WIDE, 0.0, 50.0) as spool:
        for text in "abc":
            spool.append(carrying(text), 0.0, 50.0)
        spool.bury(2, "422 no such robot")
        assert [(each.sequence, each.reason, each.message.body) for each in dead_letters(place)] == [
            (2, "422 no such robot", b"b")
        ]
        assert waiting(spool) == [1, 3]
        assert spool.revive() == 1
        assert waiting(spool) == [1, 2, 3]


def test_a_second_streamer_is_refused_with_the_process_of_the_first(place: Path) -> None:
    with (
        Spool(place, WIDE, 0.0, 0.0),
        pytest.raises(OperationFailed, match=r"process \d+ streams from it; .*--spool"),
    ):
        Spool(place, WIDE, 0.0, 0.0)
    Spool(place, WIDE, 0.0, 0.0).close()


def test_a_file_that_is_no_spool_is_set_aside_and_no_key_comes_back(place: Path) -> None:
    with Spool(place, WIDE, 0.0, 0.0) as spool:
        before = spool.tally.stream
        spool.append(carrying("a"), 0.0, 0.0)
    (place / FILE).write_bytes(b"rubbish" * 1000)
    with Spool(place, WIDE, 0.0, 0.0) as spool:
        assert "not a database" in spool.set_aside
        assert spool.tally.stream != before
        assert spool.append(carrying("a"), 0.0, 0.0) == 1
    assert (place / BROKEN).read_bytes() == b"rubbish" * 1000


def test_a_full_disk_changes_nothing_and_is_over_when_there_is_room(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = []
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *a, **k: opened.append(connect(*a, **k)) or opened[-1])
    with Spool(place, WIDE, 0.0, 0.0) as spool:
        spool.append(carrying("a"), 0.0, 0.0)
        (base,) = opened
        pages = base.execute("PRAGMA page_count").fetchone()[0]
        base.execute(f"PRAGMA max_page_count={pages}")
        before = spool.tally
        with pytest.raises(sqlite3.OperationalError, match="full"):
            spool.append(carrying("b" * 100_000), 0.0, 0.0)
        assert spool.tally == before
        assert waiting(spool) == [1]
        base.execute("PRAGMA max_page_count=1000000")
        assert spool.append(carrying("b" * 100_000), 0.0, 0.0) == 2


def test_a_folder_that_cannot_be_made_is_an_error_of_the_system(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        Spool(tmp_path / "file" / "spool", WIDE, 0.0, 0.0)


FOREIGN_ROWS = {
    "headers that are no JSON": "1, 1.0, 1.0, 'none', 1, NULL, x'00'",
    "headers that are a list": "1, 1.0, 1.0, '[1]', 1, NULL, x'00'",
    "headers that are no UTF-8": "1, 1.0, 1.0, CAST(x'ff7b' AS TEXT), 1, NULL, x'00'",
    "a time that is text": "1, 1.0, 'x', '{}', 1, NULL, x'00'",
    "a time that is infinite": "1, 1.0, 9e999, '{}', 1, 'dead', x'00'",
    "a run that is text": "'x', 1.0, 1.0, '{}', 1, NULL, x'00'",
    "a count that is text": "1, 1.0, 1.0, '{}', 'many', 'dead', x'00'",
    "a body that is a number": "1, 1.0, 1.0, '{}', 1, NULL, 7",
    "a reason that is bytes": "1, 1.0, 1.0, '{}', 1, x'ff', x'00'",
}
FOREIGN_TABLES = {
    "a run that is text": "UPDATE tally SET run = 'x'",
    "a run without a successor": "UPDATE tally SET run = 9223372036854775807",
    "a count that is text": "UPDATE tally SET sent = 'x'",
    "a name that is bytes": "UPDATE tally SET stream = x'ff'",
    "a sequence without a successor": "UPDATE sqlite_sequence SET seq = 9223372036854775807",
    "other columns": "DROP TABLE message; CREATE TABLE message (a)",
}


def changed_by(folder: Path, script: str) -> None:
    with Spool(folder, WIDE, 0.0, 0.0) as spool:
        spool.append(carrying("ours"), 0.0, 0.0)
    base = sqlite3.connect(folder / FILE)
    base.executescript(script)
    base.close()


@pytest.mark.parametrize("what", FOREIGN_ROWS)
def test_a_row_that_no_streamer_wrote_is_set_aside_and_the_others_are_sent(what: str) -> None:
    row = (
        f"INSERT INTO message (run, made, wall, headers, samples, reason, body) VALUES ({FOREIGN_ROWS[what]})"
    )
    with folder() as place:
        changed_by(place, row)
        assert dead_letters(place) == []
        with Spool(place, WIDE, 1.0, 1.0) as spool:
            assert "1 rows that no streamer wrote are in its table `aside`" in spool.set_aside
            kept = spool.oldest()
            assert kept is not None and kept.message.body == b"ours"
            assert spool.oldest(kept.sequence) is None
            assert (spool.tally.waiting, spool.tally.dead) == (1, 0)
        base = sqlite3.connect(place / FILE)
        assert base.execute("SELECT count(*) FROM aside").fetchone() == (1,)
        base.close()


@pytest.mark.parametrize("what", FOREIGN_TABLES)
def test_a_spool_of_another_program_is_kept_beside_a_new_one(what: str) -> None:
    with folder() as place:
        changed_by(place, FOREIGN_TABLES[what])
        with Spool(place, WIDE, 1.0, 1.0) as spool:
            assert "kept beside a new one" in spool.set_aside and (place / BROKEN).exists()
            spool.append(carrying("new"), 1.0, 1.0)


@pytest.mark.parametrize("room", [4096, 40_000])
def test_a_spool_on_a_full_disk_refuses_a_message_and_takes_the_next_when_there_is_room(room: int) -> None:
    with folder() as place, Spool(place, WIDE, 0.0, 0.0) as spool:
        spool.append(carrying("first"), 0.0, 0.0)
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
            with pytest.raises(sqlite3.Error):
                spool.append(carrying("x" * 100_000), 0.0, 0.0)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            signal.signal(signal.SIGXFSZ, ignored)
        assert spool.tally.waiting == 1
        spool.append(carrying("second"), 0.0, 0.0)
        assert spool.tally.waiting == 2


def test_a_step_of_the_wall_clock_drops_no_message_of_this_run() -> None:
    with folder() as place, Spool(place, SpoolLimits(1 << 20, 600.0), 0.0, 1.8e9) as spool:
        spool.append(carrying("a"), 1.0, 1.8e9)
        for wall in (1.8e9 + 3600.0, 1.8e9 - 3600.0, 0.0):
            spool.expire(2.0, wall)
        assert (spool.tally.waiting, spool.tally.dropped) == (1, 0)
