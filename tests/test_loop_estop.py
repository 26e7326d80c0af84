"""E-stops that meet another e-stop, on real bytes under a fake clock: what each answer rests on."""

from rig import Rig

from twind import link


def test_a_cut_after_a_settling_stop_is_not_answered_before_torque_is_read_back() -> None:
    """The first stop's confirmation is not the second's: one servo is silent by then."""
    rig = Rig()
    try:
        rig.arm()
        rig.submit(rig.path("head_yaw", [0.4], [1.0]))
        rig.ticks(50)
        first = rig.call(link.EStop)
        assert (first.parameters["torque_off"], first.parameters["done"]) == (False, False)
        rig.virtual["main"].faults.silence(5)
        second = rig.send(link.EStop, client=9, level="cut")
        rig.ticks(50)
        assert not rig.replies(second)
        rig.seconds(2.0)
        reply = rig.replies(second)[-1]
        assert reply.parameters["torque_off"] is not True
        assert rig.events("TORQUE_MISMATCH")
    finally:
        rig.close()


def test_a_settling_stop_after_a_reset_is_not_answered_before_its_own_goals_are_read_back() -> None:
    rig = Rig()
    try:
        rig.arm()
        rig.call(link.EStop, level="settle")
        rig.seconds(6.0)
        assert not rig.register("torque_enable").any()
        assert rig.call(link.Reset).error is None
        rig.lease()
        assert rig.call(link.Arm).error is None
        rig.virtual["main"].faults.silence(5)
        second = rig.send(link.EStop, level="settle")
        rig.ticks(20)
        assert not rig.replies(second)
        rig.seconds(8.0)
        assert rig.replies(second)[-1].parameters["torque_off"] is not True
    finally:
        rig.close()
