"""Every reason code is reached by a real run: walked over the enum, so that no new code is forgotten."""

from pathlib import Path

import pytest
import scenes_asked
import scenes_front
import scenes_gate
import scenes_running
import stage

from twind.robot.finding import ReasonCode

ROOMS = (scenes_gate.SCENES, stage.SCENES, scenes_front.SCENES)
assert scenes_asked and scenes_running  # they fill the stage
SCENES = {code: scene for room in ROOMS for code, scene in room.items()}
MARKS = {code: [pytest.mark.realtime] for code in scenes_front.SCENES}


@pytest.mark.parametrize("code", [pytest.param(code, marks=MARKS.get(code, [])) for code in ReasonCode])
def test_every_code_is_reached(code: ReasonCode, tmp_path: Path) -> None:
    assert code in SCENES, f"no situation leads to {code}: add one"
    told = set(SCENES[code](tmp_path))
    assert code.value in told, f"{SCENES[code].__name__} led to {sorted(told)}"


def test_each_code_has_one_situation() -> None:
    assert sum(map(len, ROOMS)) == len(SCENES)
