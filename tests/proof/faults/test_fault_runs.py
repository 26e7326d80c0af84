"""Fault runs under the fake clock: readings are right, or stale and marked, or absent; never wrong and fresh.

Every fault of the table of orders is walked, so that a new one cannot be forgotten. Faults by the matrix of
`docs/reason-codes.md`; what a fault does on the wire by `docs/virtual.md`.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.fault_cases import ARMED, CASES, EITHER, FAULT, Case, Order, healing, order
from tests.support.fault_rig import Judge, Moved, Wire, nod_all
from twind import link
from twind.robot.modes import Mode, Motion, RobotState
from twind.virtual.fault_commands import arguments
from twind_drivers.dynamixel.servo_twin import FAULTS

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time

WALK = [(name, number) for name, cases in CASES.items() for number in range(len(cases))]
# Where nothing is latched nobody takes the robot down, so one way down is as good as two.
DOWN = [
    (name, number, down)
    for name, number in WALK
    for down in ((link.EStop,) if CASES[name][number].ends == ARMED else (link.EStop, link.Disarm))
]


def obey(rig: Rig, orders: Sequence[Order]) -> None:
    """Carry out orders on every bus, as the socket would."""
    for each in orders:
        name, given = arguments(each, FAULTS)
        for bus in rig.virtual.values():
            bus.advance(rig.clock.now())
            getattr(bus.faults, name)(**given)


def test_every_fault_that_can_be_ordered_has_its_cases() -> None:
    assert CASES.keys() == FAULTS.keys() - {"lay"}  # turned over is a body: these joints have none
    assert all(CASES.values())


# --------------------------------------------------------------------------------------------- the mirror


@pytest.fixture(scope="module")
def mirror() -> Iterator[tuple[Rig, Judge, Wire]]:
    """A mirror of a robot whose joints hands move all the time, whatever goes wrong."""
    rig = Rig(mode=Mode.MIRROR, muscles=Moved)
    judge = Judge(rig)
    wire = Wire(rig, writes=False)
    rig.connect()
    rig.seconds(0.3)
    yield rig, judge, wire
    rig.close()


def all_fresh_again(rig: Rig, seconds: float = 3.0) -> bool:
    """Check whether all joints are fresh within that time."""
    for _ in range(round(seconds / rig.loop.robot.period)):
        rig.ticks(1)
        if rig.loop.robot.measured.heard.all() and rig.loop.hardware.connected:
            return True
    return False


@pytest.mark.parametrize(("name", "number"), WALK)
def test_a_mirror_shows_no_wrong_reading_as_fresh(
    mirror: tuple[Rig, Judge, Wire], name: str, number: int
) -> None:
    rig, judge, wire = mirror
    random = np.random.default_rng([number, *name.encode()])
    case = CASES[name][number]
    given = order(name, case, random)
    rig.ticks(int(random.integers(1, 6)))
    obey(rig, [given])
    rig.ticks(min(40, round(random.uniform(*case.lasts) / rig.loop.robot.period)))
    obey(rig, healing(case, given))
    assert all_fresh_again(rig), given
    judge.verdict(str(given))
    wire.verdict(str(given))


@pytest.mark.parametrize("late", [1, 2, 5, 8, 9, 10])
@pytest.mark.parametrize("id", [None, 15])
def test_answers_that_are_late_by_whole_cycles_are_never_taken_for_new_ones(
    mirror: tuple[Rig, Judge, Wire], id: int | None, late: int
) -> None:
    """The bus, or one servo among others that reply in time, is late; a late joint reply delays both."""
    rig, judge, _ = mirror
    rig.ticks(late)
    obey(rig, [{"fault": "delay", "seconds": 0.01 * late} | ({} if id is None else {"id": id})])
    rig.ticks(30)
    obey(rig, [{"fault": "clear"}])
    rig.ticks(5 + late)
    judge.verdict(f"id {id}, {late} cycles")


# Alone they change nothing; a run of several faults shall not be spent on them. What is forged beside a lost
# answer is, with a right CRC, a lie that nobody can know: row 6 of the matrix has it alone.
IDLE = {"free", "replug", "clear", "seed", "record", "garble", "forge"}


def several(random: np.random.Generator) -> list[tuple[Case, Order]]:
    """Two or three faults of the table, in order."""
    names = random.choice(sorted(CASES.keys() - IDLE), int(random.integers(2, 4)), replace=False).tolist()
    cases = [(name, CASES[name][int(random.integers(len(CASES[name])))]) for name in names]
    return [(case, order(name, case, random)) for name, case in cases]


def mix(rig: Rig, judge: Judge, wire: Wire, seed: int) -> int:
    """Several faults at once, at odd moments, healed in any order; how many they were."""
    random = np.random.default_rng(seed)
    faults = several(random)
    said = f"seed {seed}: {[given for _, given in faults]}"
    obey(rig, [{"fault": "seed", "number": seed}])
    for _, given in faults:
        rig.ticks(int(random.integers(0, 5)))
        obey(rig, [given])
    rig.ticks(int(random.integers(5, 15)))
    for at in random.permutation(len(faults)).tolist():
        obey(rig, healing(*faults[at]))
        rig.ticks(int(random.integers(0, 5)))
    judge.verdict(said)
    wire.verdict(said)
    return len(faults)


def run_mixes(judged: tuple[Rig, Judge, Wire], seeds: range, least: int) -> None:
    rig, judge, wire = judged
    assert sum(mix(rig, judge, wire, seed) for seed in seeds) >= least
    assert all_fresh_again(rig, 5.0)
    judge.verdict(str(seeds))
    assert judge.fresh > 20 * len(seeds), "nobody was heard: the judge saw nothing"
    assert judge.stale > 20 * len(seeds), "nothing went wrong: the judge saw nothing"


def test_a_thousand_faults_make_no_wrong_reading_fresh(mirror: tuple[Rig, Judge, Wire]) -> None:
    run_mixes(mirror, range(1000, 1500), 1000)


# --------------------------------------------------------------------------------------------- armed


def nodding(rig: Rig) -> None:
    """All joints on their way, to and fro."""
    ticket = rig.submit(nod_all(rig), more=True)
    rig.ticks(20)
    assert rig.loop.executor.motion is Motion.ACTIVE, rig.replies(ticket)


def first_events(rig: Rig, since: float) -> dict[str, float]:
    """Time of the first report of each code, s after `since`."""
    found: dict[str, float] = {}
    for event in rig.events():
        if event.time >= since:
            found.setdefault(event.code, event.time - since)
    return found


def bring_back(rig: Rig, down: type[link.Command], **how: Any) -> None:
    """Torque off, latches acknowledged, servos that shut themselves down restarted, and armed again."""
    if rig.loop.condition.latches:
        while down is link.Disarm and rig.loop.procedures.rank is not None:
            rig.ticks(1)  # it is on its way down already
        assert rig.call(down, ticks=900, **how).error is None
        assert rig.call(link.Reset).error is None
        for name, bus in rig.virtual.items():
            for row in np.flatnonzero(bus.servos["hardware_error_status"]).tolist():
                id = bus.servos.registers.id_of(row)
                assert rig.call(link.Reboot, bus=name, id=id).error is None
                rig.ticks(5)
        rig.connect()
        rig.seconds(1.05)  # servos that restart do not answer, and the rules look back a second
        rig.lease()
        reply = rig.call(link.Arm)
        assert reply.error is None, reply
    rig.lease()
    nodding(rig)
    assert rig.loop.condition.state is RobotState.ARMED
    assert np.asarray(rig.register("torque_enable")).all()


@pytest.mark.parametrize(("name", "number", "down"), DOWN)
def test_an_armed_robot_reports_each_fault_in_time_and_can_be_armed_again(
    live: Rig, name: str, number: int, down: type[link.Command]
) -> None:
    """Bounds: threshold, refresh period and two ticks (docs/reason-codes.md)."""
    rig = live
    judge = Judge(rig)
    wire = Wire(rig, writes=True)
    case = CASES[name][number]
    random = np.random.default_rng([number, *name.encode()])
    given = order(name, case, random)
    rig.arm()
    nodding(rig)
    rig.ticks(int(random.integers(0, 40)))
    begun = rig.clock.now()
    obey(rig, [given])
    rig.seconds(random.uniform(*case.lasts))
    obey(rig, healing(case, given))
    rig.seconds(1.05)  # the rules look back a second
    codes = first_events(rig, begun)
    if case.alarm:
        assert min(codes.get(code, np.inf) for code in case.alarm) <= case.within, (given, codes)
    assert case.ends in (EITHER, FAULT if rig.loop.condition.latches else ARMED), (given, codes)
    assert rig.loop.torque.armed or rig.loop.condition.latches, "torque went off, and nothing says so"
    bring_back(rig, down, **({"level": "cut"} if down is link.EStop else {}))
    judge.verdict(str(given))
    wire.verdict(str(given))


# ------------------------------------------------------------------------------------ servos that lie


def test_a_turn_lost_at_a_restart_is_taken_from_the_register_and_reported(
    mirror: tuple[Rig, Judge, Wire],
) -> None:
    """e-manual, "Operating Mode" note: at power-up a position falls back to one turn (SENSE_JUMP)."""
    rig, judge, _ = mirror
    shaft = rig.virtual["main"].servos.muscles.position
    begun = rig.clock.now()
    for _ in range(205):
        shaft[8] += 20.0  # a hand turns it once around
        rig.ticks(1)
    obey(rig, [{"fault": "unplug"}])
    rig.ticks(20)
    obey(rig, [{"fault": "replug"}])
    assert all_fresh_again(rig)
    rig.ticks(20)
    before = rig.loop.hardware.readings.position[8]
    assert np.isnan(rig.loop.robot.measured.position[8]), "position mode, a turn off: its place is unknown"
    obey(rig, [{"fault": "brown_out", "id": 9}])
    rig.seconds(0.4)
    assert {"SERVO_REBOOTED", "SENSE_JUMP"} & first_events(rig, begun).keys(), first_events(rig, begun)
    assert all_fresh_again(rig)
    assert abs(rig.loop.hardware.readings.position[8] - before) > 3.0, "the register lost a turn"
    judge.verdict()


def test_a_frozen_encoder_is_shown_as_its_register_shows_it(mirror: tuple[Rig, Judge, Wire]) -> None:
    """The reading is right: it is the servo that lies. The velocity register goes on."""
    rig, judge, _ = mirror
    rig.ticks(100)  # what was before is over
    assert all_fresh_again(rig)
    shown = rig.loop.hardware.readings
    obey(rig, [{"fault": "freeze", "id": 5}])
    rig.ticks(2)
    stuck = shown.position[4]
    rig.ticks(10)
    assert shown.position[4] == stuck
    assert rig.loop.robot.measured.heard.all()
    obey(rig, [{"fault": "freeze", "id": 5, "on": False}])
    rig.ticks(10)
    assert shown.position[4] != stuck
    judge.verdict()
