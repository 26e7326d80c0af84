"""Log of an uplink: complete, unless a remote sender causes too many lines."""

from twind.bridge.uplink.uplink_command import AT_ONCE, EACH, RateLimitedLog


def test_a_flood_of_lines_is_cut_and_replaced_by_a_count() -> None:
    clock = [0.0]
    said = list[str]()
    saying = RateLimitedLog(said.append, lambda: clock[0])
    for number in range(1000):
        saying(f"line {number}")
    assert said == [f"line {number}" for number in range(AT_ONCE)]
    clock[0] += EACH
    saying("the next")
    assert said[AT_ONCE:] == [f"the next (and {1000 - AT_ONCE} lines before it, left out)"]
    clock[0] += EACH
    saying("one more")
    assert said[-1] == "one more"


def test_a_log_below_the_rate_limit_loses_no_line() -> None:
    clock = [0.0]
    said = list[str]()
    saying = RateLimitedLog(said.append, lambda: clock[0])
    for number in range(1000):
        saying(str(number))
        clock[0] += EACH
    assert len(said) == 1000
