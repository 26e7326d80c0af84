"""The whole loop refuses a motion that its guard would hold at once, and says why."""

from tests.support.daemon_rig import Rig
from twind import link


def break_exchanges(rig: Rig, count: int) -> None:
    """Spoil `count` exchanges, never several in a row."""
    for _ in range(count):
        rig.virtual["main"].faults.bit_errors(0.1, to_servos=False)
        rig.ticks(1)
        rig.virtual["main"].faults.bit_errors(0.0, to_servos=False)
        rig.ticks(1)


def refusals(reply: link.Reply) -> set[str]:
    return {finding["code"] for finding in reply.parameters.get("findings", ())}


def test_on_a_bus_with_errors_motions_are_refused_and_none_is_accepted_and_aborted(armed: Rig) -> None:
    break_exchanges(armed, 25)
    armed.lease()
    accepted = 0
    for _ in range(12):
        ticket = armed.submit(armed.path("head_yaw", [0.3], [2.0]), more=True)
        armed.ticks(2)
        reply = armed.replies(ticket)[0]
        accepted += reply.error is None
        assert "BUS_ERRORS" in refusals(reply)
    setpoint = armed.call(link.Setpoint, joints=[0], positions=[0.0])
    assert (setpoint.error, refusals(setpoint)) == ("Refused", {"BUS_ERRORS"})
    assert accepted == 0
    assert not armed.events("MOTION")
    armed.seconds(1.1)
    armed.lease()
    ticket = armed.submit(armed.path("head_yaw", [0.3], [2.0]), more=True)
    armed.ticks(20)
    assert [reply.parameters["phase"] for reply in armed.replies(ticket)][:2] == ["accepted", "running"]


def test_a_check_gives_what_would_hold_a_motion_now_as_a_warning(armed: Rig) -> None:
    break_exchanges(armed, 25)
    ticket = armed.submit(armed.path("head_yaw", [0.3], [2.0]), check_only=True)
    armed.ticks(2)
    verdict = armed.replies(ticket)[0].parameters["verdict"]
    assert verdict["refusals"] == []
    assert "BUS_ERRORS" in {finding["code"] for finding in verdict["warnings"]}


def test_a_motion_that_arrives_while_ticks_are_missed_is_refused_and_the_next_one_accepted(
    armed: Rig,
) -> None:
    armed.loop.figures.missed_in_a_row = 7
    second = armed.submit(armed.path("head_yaw", [0.1], [2.0]))
    armed.loop.run(until=armed.clock.now() + 1e-9)
    armed.collect_news()
    assert refusals(armed.replies(second)[0]) == {"LOOP_LATE"}
    armed.ticks(2)
    third = armed.submit(armed.path("head_yaw", [0.1], [2.0]))
    armed.ticks(2)
    assert armed.replies(third)[0].error is None
