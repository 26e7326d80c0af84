"""The checker of histories: it lets sound ones pass and finds what is broken in broken ones."""

from dataclasses import replace
from math import inf

import pytest

from tests.proof.model.history import History, Op


def op(
    client: int, name: str, begin: float, end: float | None = None, result: str = "ok", **more: object
) -> Op:
    made = Op(client, name, begin, begin + 0.01 if end is None else end, result)
    return replace(made, **more)  # type: ignore[arg-type]


def motion(client: int, begin: float, **more: object) -> Op:
    given = {"motion": f"m{begin}", "fate": "succeeded"} | more
    return op(client, "SubmitTrajectory", begin, **given)


def wrong(*ops: Op, gone: dict[int, float] | None = None, deaths: tuple[float, ...] = ()) -> str:
    return "\n".join(History(list(ops), gone or {}, list(deaths)).wrong())


ACQUIRE = "AcquireLease"
RENEW = "RenewLease"
RELEASE = "ReleaseLease"
SETPOINT = "Setpoint"
ARM = "Arm"

SOUND = {
    "one after the other gave it back": [op(1, ACQUIRE, 0.0), op(1, RELEASE, 0.2), op(2, ACQUIRE, 0.3)],
    "it lapsed": [op(1, ACQUIRE, 0.0), op(2, ACQUIRE, 1.02)],
    "it lapsed after a setpoint": [op(1, ACQUIRE, 0.0), op(1, SETPOINT, 0.1), op(2, ACQUIRE, 0.4)],
    "it was kept, and the other refused": [
        op(1, ACQUIRE, 0.0),
        op(1, RENEW, 0.9),
        op(2, ACQUIRE, 1.5, result="LeaseHeld"),
        op(1, RENEW, 1.8),
    ],
    "it was taken": [
        op(1, ACQUIRE, 0.0),
        op(2, ACQUIRE, 0.1, take=True),
        op(1, RENEW, 0.2, result="LEASE_MISSING"),
        op(2, RENEW, 0.3),
    ],
    "who lost it gives back what it has no more": [
        op(1, ACQUIRE, 0.0),
        op(2, ACQUIRE, 0.1, take=True),
        op(1, RENEW, 0.2, result="LEASE_MISSING"),
        op(1, RELEASE, 0.3),
        op(2, ARM, 0.4),
    ],
    "both asked at once": [op(1, ACQUIRE, 0.0, 0.5), op(2, ACQUIRE, 0.0, 0.5, result="LeaseHeld")],
    "one was told late that it had it, and by then it was taken": [
        op(1, ACQUIRE, 0.0, 0.5),
        op(2, ACQUIRE, 0.1, 0.2, take=True),
        op(2, RENEW, 0.6),
        op(1, RENEW, 0.7, result="LEASE_MISSING"),
    ],
    "it was taken before its first holder was told, who gives back what it has no more": [
        op(1, ACQUIRE, 0.0, 0.15),
        op(2, ACQUIRE, 0.1, 0.16, take=True),
        op(1, RELEASE, 0.5),
    ],
    "a call to take it that was answered late came before": [
        op(2, ACQUIRE, 0.0, 1.5, take=True),
        op(1, ACQUIRE, 1.2, 1.3),
        op(1, RENEW, 2.2),
    ],
    "one motion kept it": [
        op(1, ACQUIRE, 0.0),
        motion(1, 0.1, more=True, kept=5.0),
        op(2, ACQUIRE, 3.0, result="LeaseHeld"),
        motion(1, 4.9),
    ],
    "it was used in time": [op(1, ACQUIRE, 0.0), op(1, ARM, 0.5), motion(1, 0.9)],
    "it was refused after a lapse": [op(1, ACQUIRE, 0.0), motion(1, 1.2, result="LEASE_MISSING", fate="")],
    "nobody answered": [op(1, ACQUIRE, 0.0, inf, ""), op(2, ACQUIRE, 0.1)],
    "an abort has its code": [op(1, ACQUIRE, 0.0), motion(1, 0.1, fate="aborted", codes=("LEASE_LOST",))],
    "a motion died with the daemon": [op(1, ACQUIRE, 0.0), motion(1, 0.1, fate="lost")],
    "a refused motion needs no end": [op(1, ACQUIRE, 0.0), motion(1, 0.1, result="VEL_LIMIT", fate="")],
    "it took its own again after a lapse": [
        op(1, ACQUIRE, 0.0),
        op(2, ACQUIRE, 1.2),
        op(2, RELEASE, 1.3),
        op(1, ACQUIRE, 1.4),
    ],
}

BROKEN = {
    "two got it at once": ([op(1, ACQUIRE, 0.0), op(2, ACQUIRE, 0.1)], "two holders"),
    "it was given although renewed": (
        [op(1, ACQUIRE, 0.0), op(1, RENEW, 0.9), op(2, ACQUIRE, 1.5)],
        "two holders",
    ),
    "it was given although a motion kept it": (
        [op(1, ACQUIRE, 0.0), motion(1, 0.1, more=True, kept=5.0), op(2, ACQUIRE, 3.0)],
        "two holders",
    ),
    "the one it was taken from is still obeyed": (
        [op(1, ACQUIRE, 0.0), op(2, ACQUIRE, 0.1, take=True), op(1, RENEW, 0.5)],
        "obeyed without",
    ),
    "it was given although it was asked for since a take that came before": (
        [
            op(2, ACQUIRE, 0.0, 0.2, take=True),
            op(1, ACQUIRE, 0.1, take=True),
            op(1, RENEW, 0.3),
            op(3, ACQUIRE, 0.5),
        ],
        "two holders",
    ),
    "the one it was taken from, before it was told, is still obeyed": (
        [op(1, ACQUIRE, 0.0, 0.5), op(2, ACQUIRE, 0.1, 0.2, take=True), op(2, RENEW, 0.6), op(1, RENEW, 0.7)],
        "two holders",
    ),
    "one who never had it is obeyed": ([motion(3, 0.1)], "obeyed without"),
    "one is obeyed after a lapse": ([op(1, ACQUIRE, 0.0), op(1, SETPOINT, 1.2)], "obeyed without"),
    "one is armed after giving it back": (
        [op(1, ACQUIRE, 0.0), op(1, RELEASE, 0.1), op(1, ARM, 0.3)],
        "obeyed without",
    ),
    "a stream is obeyed after its short term": (
        [op(1, ACQUIRE, 0.0), op(1, SETPOINT, 0.8), op(1, RENEW, 1.9)],
        "obeyed without",
    ),
    "the holder is refused": (
        [op(1, ACQUIRE, 0.0), op(1, RENEW, 0.5, result="LEASE_MISSING")],
        "although it held",
    ),
    "a follower is refused": (
        [op(1, ACQUIRE, 0.0), motion(1, 0.1, more=True, kept=5.0), op(1, ARM, 4.0, result="LEASE_MISSING")],
        "although it held",
    ),
    "a motion was never told of again": ([op(1, ACQUIRE, 0.0), motion(1, 0.1, fate="")], "never told"),
    "an abort has no code": ([op(1, ACQUIRE, 0.0), motion(1, 0.1, fate="aborted")], "without a code"),
    "two motions have one id": (
        [op(1, ACQUIRE, 0.0), motion(1, 0.1, motion="x"), motion(1, 0.2, motion="x")],
        "one id",
    ),
}


@pytest.mark.parametrize("case", SOUND)
def test_a_possible_history_passes(case: str) -> None:
    assert wrong(*SOUND[case]) == ""


@pytest.mark.parametrize("case", BROKEN)
def test_an_impossible_history_is_found(case: str) -> None:
    ops, why = BROKEN[case]
    assert why in wrong(*ops)


def test_a_connection_that_closed_holds_nothing() -> None:
    ops = [op(1, ACQUIRE, 0.0), op(2, ACQUIRE, 0.2)]
    assert wrong(*ops, gone={1: 0.1}) == ""
    assert "two holders" in wrong(*ops, gone={1: 0.5})
    assert "obeyed without" in wrong(op(1, ACQUIRE, 0.0), op(1, RENEW, 0.5), gone={1: 0.1})


def test_a_death_of_the_front_ends_every_lease() -> None:
    ops = [op(1, ACQUIRE, 0.0), op(2, ACQUIRE, 0.4)]
    assert wrong(*ops, deaths=(0.2,)) == ""
    assert "two holders" in wrong(*ops, deaths=(0.9,))
    assert "obeyed without" in wrong(op(1, ACQUIRE, 0.0), motion(1, 0.5), deaths=(0.2,))


def test_a_call_without_a_reply_in_time_is_named() -> None:
    history = History([op(1, ARM, 0.0, inf, "")])
    assert history.unanswered(10.0, 32.0) == []
    assert "not answered" in history.unanswered(33.0, 32.0)[0]
