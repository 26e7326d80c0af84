"""Every reason code is reached by a real run: walked over the enum, so that no new code is forgotten."""

from pathlib import Path

import pytest

from tests.support import scene_rig as stage
from tests.support import scenes_front, scenes_gate
from tests.support import scenes_guard as scenes_running
from tests.support import scenes_requests as scenes_asked
from twind.robot.finding import ReasonCode

ROOMS = (scenes_gate.SCENES, stage.SCENES, scenes_front.SCENES)
assert scenes_asked and scenes_running  # they fill the stage
SCENES = {code: scene for room in ROOMS for code, scene in room.items()}


@pytest.mark.parametrize("code", [code for code in ReasonCode if code not in scenes_front.SCENES])
def test_every_code_is_reached(code: ReasonCode, tmp_path: Path) -> None:
    assert code in SCENES, f"no situation leads to {code}: add one"
    told = set(SCENES[code](tmp_path))
    assert code.value in told, f"{SCENES[code].__name__} led to {sorted(told)}"


def test_each_code_has_one_situation() -> None:
    assert sum(map(len, ROOMS)) == len(SCENES)
