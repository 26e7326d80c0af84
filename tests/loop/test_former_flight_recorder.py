"""A former daemon's recording is released once: when it is written, or after two fronts died of it."""

import os

from twind.loop.ipc.former_flight_recorder import FRONTS, FormerFlightRecorder


def recording() -> tuple[FormerFlightRecorder, list[str]]:
    made = FormerFlightRecorder(os.memfd_create("wreck"))
    told = list[str]()
    made.then = lambda: told.append("done")
    return made, told


def there(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True


def test_a_crash_recording_is_kept_until_it_is_done_which_is_reported_once() -> None:
    one, told = recording()
    one.offer()
    fd = one.fd
    assert fd is not None
    one.taken()
    assert (there(fd), told) == (True, [])
    one.done()
    one.done()
    one.offer()
    assert (there(fd), told, one.fd) == (False, ["done"], None)


def test_a_crash_recording_is_offered_to_a_second_front_and_no_third() -> None:
    one, told = recording()
    for _ in range(FRONTS):
        one.offer()
        assert one.fd is not None
        one.taken()
    assert told == []
    one.offer()
    assert one.fd is None
    assert told == ["done"]


def test_a_front_that_could_not_be_started_does_not_count() -> None:
    one, told = recording()
    for _ in range(FRONTS + 3):
        one.offer()
    assert one.fd is not None
    assert told == []
    one.close()


def test_closed_here_it_stays_where_it_is_kept() -> None:
    one, told = recording()
    fd = one.fd
    assert fd is not None
    one.close()
    assert (there(fd), told) == (False, [])


def test_an_absent_crash_recording_reports_nothing() -> None:
    one = FormerFlightRecorder(None)
    told = list[str]()
    one.then = lambda: told.append("done")
    one.taken()
    one.done()
    one.offer()
    assert (one.fd, told) == (None, [])
