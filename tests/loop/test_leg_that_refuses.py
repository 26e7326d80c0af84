"""A robot on its own feet, found with torque, and a leg whose servo refuses to be taken over."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link

BENT = {"l_knee": 0.6, "r_knee": 0.6}


@pytest.mark.parametrize("stop", [link.Disarm, link.EStop])
def test_the_other_leg_is_not_driven_and_all_yield_at_once(
    make_rig: MakeRig, stop: type[link.Command]
) -> None:
    """It took 4 s of crouching on one leg until they did."""
    rig: Rig = make_rig("h24", support="free", start=BENT)
    left, right = rig.names.index("l_knee"), rig.names.index("r_knee")
    (bus,) = rig.virtual.values()
    for row in range(len(bus.servos["id"])):
        bus.servos.torque(row, True)
    rig.connect()
    memory = bus.servos.memory
    memory.store(left, memory.tables[left]["operating_mode"], 4)
    before = rig.truth[right]
    rig.send(stop)
    begun = rig.clock.now()
    furthest = 0.0
    while not rig.events("DAMP") and rig.clock.now() - begun < 2.0:
        rig.ticks(1)
        furthest = max(furthest, abs(rig.truth[right] - before))
    assert rig.clock.now() - begun < 1.0 and furthest < 0.02
    told = [each.message for each in rig.events("SETTLE")]
    assert told == ["l_knee cannot come to the rest pose: no way there on the other leg"]
    rig.seconds(8.0)
    assert not np.any(rig.register("torque_enable"))
