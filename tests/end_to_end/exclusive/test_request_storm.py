"""Six seconds of the storm; `make soak MINUTES=10 REAL=1` makes it long."""

from tests.proof.soak.storm import storm


def test_a_short_storm_over_real_processes_breaks_no_rule() -> None:
    found = storm(6.0, 3)
    assert not found["wrong"], found
    assert found["bus"]["packets"] > 500
