"""Excitation of a robot refuses what would falsify its result."""

from typing import Any, cast

import msgspec
import pytest

from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.identification.live_excitation import excite_robot


def test_a_robot_with_offsets_against_gravity_is_not_moved_and_the_remedy_is_named() -> None:
    described = msgspec.to_builtins(load_robot("so101"), enc_hook=str) | {"compensate_gravity": True}
    nothing = cast("Any", object())  # any use of robot or client fails
    with pytest.raises(Rejected, match=r"compensate_gravity: false.*restart the daemon"):
        excite_robot(nothing, nothing, described, ["shoulder_lift"], 0.4)
