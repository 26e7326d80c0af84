"""Mode and lease: what is answered, refused and held. On scripted buses."""

from typing import Any

import pytest

from tests.support.command_rig import CLIENT, OTHER, CommandRig, ended, streams
from twind import link
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion


@pytest.fixture
def rig() -> CommandRig:
    return CommandRig()


# ------------------------------------------------------------------------------- mode


def test_an_unknown_mode_is_refused_with_the_known_ones(rig: CommandRig) -> None:
    reply = rig.call(link.SetMode, mode="lively")
    assert reply.error == "NotFound"
    assert reply.parameters == {"what": "mode", "name": "lively", "known": ["sim", "mirror", "live"]}


def test_the_present_mode_is_confirmed_and_not_entered_again(rig: CommandRig) -> None:
    rig.found()
    rig.handlers.homing.busy = lambda: "knee gets its mode back"  # type: ignore[method-assign,assignment]
    rig.reports.urgent = False
    assert rig.call(link.SetMode, mode="live").parameters == {"mode": "live"}
    assert rig.entered == [] and not rig.reports.urgent


def test_another_mode_is_entered_and_reported(rig: CommandRig) -> None:
    rig.reports.urgent = False
    assert rig.call(link.SetMode, mode="mirror").parameters == {"mode": "mirror"}
    assert rig.entered == [Mode.MIRROR] and rig.reports.urgent


def test_no_mode_is_left_while_a_servo_gets_its_settings_back(rig: CommandRig) -> None:
    rig.handlers.homing.busy = lambda: "knee gets its mode back"  # type: ignore[method-assign,assignment]
    reply = rig.call(link.SetMode, mode="sim")
    assert (reply.error, reply.parameters) == ("Busy", {"what": "knee gets its mode back"})
    assert rig.entered == []


@pytest.mark.parametrize(
    ("before", "after", "refused"),
    [
        (Mode.LIVE, "mirror", True),
        (Mode.LIVE, "sim", True),
        (Mode.MIRROR, "sim", True),
        (Mode.MIRROR, "live", False),
        (Mode.SIM, "live", True),
    ],
)
def test_with_torque_only_the_change_from_mirror_to_live_is_allowed(
    rig: CommandRig, before: Mode, after: str, refused: bool
) -> None:
    rig.condition.mode = before
    rig.found()
    reply = rig.call(link.SetMode, mode=after)
    assert (reply.error is not None) is refused and bool(rig.entered) is not refused
    if refused:
        assert reply.parameters["findings"] == [
            Finding(ReasonCode.MODE_DENIES, message="torque is on: disarm first")
        ]


def test_mode_live_is_kept_while_torque_of_a_lost_bus_may_be_on(rig: CommandRig) -> None:
    rig.hardware.away[:] = True
    rig.torque.lose_bus(rig.hardware.away)
    [finding] = rig.call(link.SetMode, mode="sim").parameters["findings"]
    assert finding.code == ReasonCode.MODE_DENIES and "restart the daemon" in finding.message
    assert rig.entered == []
    assert rig.call(link.SetMode, mode="live").error is None


def test_a_mode_that_the_state_denies_is_refused_for_that(rig: CommandRig) -> None:
    rig.hold()
    [finding] = rig.call(link.SetMode, mode="sim").parameters["findings"]
    assert finding.code == ReasonCode.MODE_DENIES and "armed" in finding.message


@pytest.mark.parametrize(("mode", "refused"), [("live", True), ("sim", False)])
def test_mode_live_may_be_denied_to_this_daemon(rig: CommandRig, mode: str, refused: bool) -> None:
    rig.condition.mode = Mode.MIRROR
    rig.parts.live_denied = denied = Finding(ReasonCode.MODE_DENIES, message="not here")
    reply = rig.call(link.SetMode, mode=mode)
    assert (reply.parameters.get("findings") == [denied]) is refused


# ------------------------------------------------------------------------------- lease


def test_a_free_lease_is_taken_reported_and_renewed(rig: CommandRig) -> None:
    rig.reports.urgent = False
    reply = rig.call(link.AcquireLease)
    assert reply.parameters == {"lease": {"holder": "ann", "uid": 5, "expires_in": 1.0}}
    assert rig.reports.urgent and rig.texts() == []
    rig.ticks(50)
    assert rig.call(link.RenewLease).parameters == {"lease": {"holder": "ann", "uid": 5, "expires_in": 1.0}}


def test_a_lease_of_another_is_shown_and_only_taken_on_demand(rig: CommandRig) -> None:
    rig.take_lease(OTHER)
    reply = rig.call(link.AcquireLease)
    assert reply.error == "LeaseHeld" and reply.parameters["lease"]["holder"] == "ann"
    assert rig.lease.held_by(OTHER, rig.clock.now())
    assert rig.call(link.AcquireLease, take=True, holder="bob").error is None
    assert rig.texts(ReasonCode.LEASE_LOST) == ["lease taken by bob"]
    assert rig.book.events[-1].level == "warning"


def test_without_the_lease_nothing_is_renewed(rig: CommandRig) -> None:
    reply = rig.call(link.RenewLease)
    assert reply.error == "Refused" and reply.parameters["findings"] == [
        Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease")
    ]


def test_a_refusal_without_a_holder_shows_a_free_lease(rig: CommandRig) -> None:
    reply = rig.call(link.AcquireLease, client=0)
    assert reply.error == "LeaseHeld"
    assert reply.parameters == {"lease": {"holder": "", "uid": -1, "expires_in": 0.0}}


@pytest.mark.parametrize("lapsed", [False, True])
def test_motion_of_another_holds_before_the_lease_changes_hands(rig: CommandRig, lapsed: bool) -> None:
    rig.take_lease(OTHER)
    rig.move()
    rig.handlers.submissions.epoch = rig.lease.epoch
    if lapsed:
        rig.ticks(150)
    assert rig.call(link.AcquireLease, take=not lapsed, holder="bob").error is None
    assert ended(rig) == Finding(ReasonCode.LEASE_LOST, message="the lease was taken by bob")


def test_own_motion_goes_on_when_the_lease_is_taken_again(rig: CommandRig) -> None:
    rig.take_lease()
    rig.move()
    rig.handlers.submissions.epoch = rig.lease.epoch
    rig.call(link.AcquireLease, take=True)
    assert rig.executor.motion is Motion.ACTIVE


def test_the_way_to_the_rest_pose_goes_on_when_the_lease_is_taken(rig: CommandRig) -> None:
    rig.move()
    rig.occupy(Priority.DISARM)
    rig.call(link.AcquireLease)
    assert rig.executor.motion is Motion.ACTIVE


@pytest.mark.parametrize(
    ("client", "motion", "rank", "stops"),
    [
        (CLIENT, Motion.STREAMING, None, [()]),
        (CLIENT, Motion.ACTIVE, None, []),
        (CLIENT, Motion.STREAMING, Priority.FAULT, []),
        (OTHER, Motion.STREAMING, None, []),
    ],
)
def test_a_stream_stops_with_the_lease_that_its_client_gives_back(
    rig: CommandRig, client: int, motion: Motion, rank: Priority | None, stops: list[Any]
) -> None:
    rig.take_lease()
    if rank is not None:
        rig.occupy(rank)
    seen = streams(rig, motion)
    rig.reports.urgent = False
    reply = rig.call(link.ReleaseLease, client=client)
    assert reply.error is None and reply.parameters == {} and rig.reports.urgent
    assert seen == stops and rig.lease.held_by(CLIENT, rig.clock.now()) is (client == OTHER)


@pytest.mark.parametrize("motion", [Motion.STREAMING, Motion.HOLDING])
def test_a_stream_of_another_stops_when_the_lease_is_taken(rig: CommandRig, motion: Motion) -> None:
    seen = streams(rig, motion)
    rig.call(link.AcquireLease)
    assert bool(seen) is (motion is Motion.STREAMING)
