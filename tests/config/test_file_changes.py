"""Files of the robot that change while the daemon runs: it arms only by the files that it has read."""

import os
from pathlib import Path

from tests.support.daemon_rig import Rig
from twind import link
from twind.config.file_changes import LARGEST, edited, fingerprints, texts


def test_a_file_is_edited_when_it_holds_something_else(tmp_path: Path) -> None:
    one = tmp_path / "one.yaml"
    other = tmp_path / "other.yaml"
    for file in (one, other):
        file.write_text("a: 1\n")
    before = fingerprints([one, other])
    assert edited(before) == []
    other.write_text("a: 2\n")
    assert edited(before) == [str(other)]
    other.write_text("a: 1\n")
    assert edited(before) == [], "restored is as good as never touched"
    one.unlink()
    assert edited(before) == [str(one)]


def test_an_unreadable_file_counts_as_edited_without_waiting(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    folder = tmp_path / "folder"
    long = tmp_path / "long"
    os.mkfifo(pipe)
    folder.mkdir()
    with long.open("wb") as file:
        file.truncate(LARGEST + 1)
    missing = tmp_path / "missing"
    everything = [pipe, folder, long, missing]
    assert edited(fingerprints(everything)) == [str(path) for path in everything]


def test_file_texts_are_kept_as_of_the_time_they_were_read(tmp_path: Path) -> None:
    same = tmp_path / "same"
    changed = tmp_path / "changed"
    binary = tmp_path / "binary"
    same.write_text("a: ä\n")
    changed.write_text("a: 1\n")
    binary.write_bytes(b"\xff\x00")
    read = fingerprints([same, changed, binary])
    first = texts(read)
    assert first == {str(same): "a: ä\n", str(changed): "a: 1\n"}
    changed.write_text("a: 2\n")
    assert texts(read) == {str(same): "a: ä\n"}, "what it says now was never read"
    assert texts(read, first) == first
    assert texts(fingerprints([changed]), first) == {str(changed): "a: 2\n"}


def test_arming_is_refused_with_every_file_named(live: Rig) -> None:
    live.connect()
    live.lease()
    reply = live.call(link.Arm, edited=["/etc/one.yaml", "/etc/other.yaml"])
    assert reply.error == "Refused"
    found = reply.parameters["findings"]
    assert [finding["code"] for finding in found] == ["CALIB_MISMATCH"] * 2
    assert "/etc/one.yaml" in found[0]["message"]
    assert (live.register("torque_enable") == 0).all()
    assert live.call(link.Arm).error is None
