"""The card of a policy: what is refused of it, and which robots it fits."""

import json
from dataclasses import replace
from typing import Any

import pytest

from tests.support.policy_files import TWO
from twind.exceptions import InvalidInput
from twind.learn.policy.policy_card import PolicyRobot, differences, read, require_fit

BODY = PolicyRobot("two", TWO.joints, TWO.layout, TWO.lower, TWO.upper, TWO.velocity, TWO.acceleration, 100.0)


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"format": "twind-policy/2"}, "'twind-policy/2'"),
        ({"format": ...}, "format"),
        ({"colour": "red"}, "'colour'"),
        ({"shaping": {"reach": "far"}}, "reach"),
        ({"shaping": {"period": 5.0}}, "steps a second"),
        ({"shaping": {"period": 0.1}}, "10 steps a second, 12.5 to 1000 are possible"),
        ({"shaping": {"smoothing": 2.0}}, "smoothing"),
        ({"shaping": {"period": float("nan")}}, "no JSON"),
        ({"joints": ["hip"]}, "one per joint"),
        ({"joints": ["hip", "hip"]}, "each once"),
        ({"default": [0.1, 1.5]}, "knee is outside"),
        ({"velocity": [0.5, 0.0]}, "velocity of knee"),
        ({"layout": {"position": [0, 1], "velocity": [3, 6]}}, "follow each other"),
        ({"velocity": ...}, "velocity"),
    ],
)
def test_a_card_that_is_not_as_agreed_is_refused(fields: dict[str, Any], error: str) -> None:
    given = json.loads(TWO.text()) | fields
    with pytest.raises(InvalidInput, match=error):
        read(json.dumps({key: value for key, value in given.items() if value is not ...}))


@pytest.mark.parametrize(
    ("body", "messages"),
    [
        ({"joints": ("hip", "ankle")}, ["no joint knee", "no joint ankle"]),
        ({"joints": ("knee", "hip")}, ["order differs"]),
        ({"layout": {"position": (0, 1), "gravity": (2, 4), "velocity": (5, 6)}}, ["velocity at 2..3"]),
        ({"layout": {"position": (0, 1), "velocity": (2, 3)}}, ["gravity at 4..6", "nothing"]),
        ({"lower": (-1.0, -0.9)}, ["knee: its lower limit -1 is beyond -0.9"]),
        ({"upper": (0.5, float("nan"))}, ["hip: its upper limit 1", "knee: its upper limit"]),
        ({"velocity": (3.0, 4.0)}, ["hip: its velocity 4 is beyond 3"]),
        ({"acceleration": (20.0, 19.0)}, ["knee: its acceleration"]),
        ({"rate_hz": 40.0}, ["50 times a second, the loop only 40"]),
    ],
)
def test_an_unfit_policy_lists_all_differences(body: dict[str, Any], messages: list[str]) -> None:
    other = replace(BODY, **body)
    text = "; ".join(differences(TWO, other))
    assert all(each in text for each in messages), text
    with pytest.raises(InvalidInput, match="made for two, it does not fit two"):
        require_fit(TWO, other)


def test_a_policy_fits_what_it_was_made_for_and_what_may_more() -> None:
    require_fit(TWO, BODY)
    require_fit(TWO, replace(BODY, upper=(2.0, 2.0), velocity=(9.0, 9.0), rate_hz=500.0))


def test_a_card_that_cannot_be_read_back_is_not_written() -> None:
    bad = replace(TWO, evaluation={"return": float("nan")})
    with pytest.raises(InvalidInput):
        bad.text()
