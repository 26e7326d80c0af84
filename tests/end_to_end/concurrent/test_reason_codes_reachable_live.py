"""Every reason code of the front is reached in a real front process."""

from pathlib import Path

import pytest

from tests.support.scenes_front import SCENES
from twind.robot.finding import ReasonCode


@pytest.mark.parametrize("code", SCENES)
def test_every_code_of_the_front_is_reached(code: ReasonCode, tmp_path: Path) -> None:
    told = set(SCENES[code](tmp_path))
    assert code.value in told, f"{SCENES[code].__name__} led to {sorted(told)}"
