"""Rows 26, 27 and 31 to 40 under the fake clock: signals, clients, files, memory, the model."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import BRAKE, World
from twind import link
from twind.config import atomic_save
from twind.config.yaml_tree import ConfigError

CALLS = ("open", "write", "fsync", "link", "replace", "close")


def terminated(world: World) -> None:
    """SIGTERM, and another at a random moment of the way: lowered, then off, then the daemon ends."""
    rig = world.moving()
    world.begun = world.now
    rig.loop.condition.stop_wanted = True
    world.ticks(int(world.random.integers(1, 300)))
    rig.loop.condition.stop_wanted = True
    ended = world.until(lambda: rig.loop.condition.finished, 12.0)
    world.claim(ended, "the daemon does not end")
    on = np.flatnonzero((world.trace.torque(world.begun) == 1).all(axis=1))
    lasted = world.trace.time[-1] if not on.size else on[-1] * world.rig.loop.robot.period
    world.claim(lasted <= 4.0 + 1.0, f"torque went off after {lasted:.1f} s")
    world.settles()


def front_hangs(world: World) -> None:
    """Nobody reads the link and no client speaks: the tick goes on, the lease ends, the motion holds."""
    rig = world.armed()
    world.joint = int(world.random.integers(24))
    world.move(more=False)
    world.begun = world.now  # its last word
    world.ticks(int(world.random.integers(0, 60)))
    # type: ignore[method-assign]
    collect = rig.collect_news
    rig.collect_news = lambda: None
    missed = rig.loop.figures.missed
    seconds = float(world.random.uniform(1.2, 3.0))
    world.seconds(seconds)
    rig.collect_news = collect  # type: ignore[method-assign]
    world.ticks(2)
    world.claim(rig.loop.figures.missed == missed, "ticks were missed")
    world.detected(1.0 + 0.02)
    world.holds(world.begun + 1.0 + 0.02 + BRAKE)
    world.claim(not rig.loop.condition.latches, f"latched {sorted(rig.loop.condition.latches)}")
    world.joint = int(world.random.integers(24))
    world.move()
    world.goes_on()


class Disk:
    """`os` whose n-th call of those that touch the disk fails with this error, or never returns."""

    def __init__(self, calls: int, error: BaseException) -> None:
        self.left = calls
        self._error = error
        self.failed = False

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in CALLS:
            return real

        def call(*given: Any, **how: Any) -> Any:
            self.left -= 1
            if self.left == 0:
                self.failed = True
                if name == "close":
                    real(*given, **how)
                raise self._error
            return real(*given, **how)

        return call


class PowerCut(BaseException):
    """The machine is off."""


def _saved(world: World, error: BaseException) -> tuple[bool, str, str, str]:
    """A file is written over while the disk fails somewhere: did it, and old, new and what is there then."""
    old = "old\n" * int(world.random.integers(1, 900))
    new = "new\n" * int(world.random.integers(1, 900))
    real = atomic_save.os
    with tempfile.TemporaryDirectory(prefix="twind-faults-") as name:
        folder = Path(name)
        atomic_save.save_text(folder, "h24", old, 20)
        disk = Disk(int(world.random.integers(1, 14)), error)
        atomic_save.os = disk  # type: ignore[attr-defined]
        told = False
        try:
            atomic_save.save_text(folder, "h24", new, 20)
        except (ConfigError, OSError, PowerCut):
            told = True
        finally:
            atomic_save.os = real  # type: ignore[attr-defined]
        there = (folder / "h24.yaml").read_text() if (folder / "h24.yaml").exists() else ""
        world.claim(told or not disk.failed, "the disk failed, and the save says nothing")
        again = "again\n" * 10
        atomic_save.save_text(folder, "h24", again, 20)
        world.claim((folder / "h24.yaml").read_text() == again, "not to be saved again")
        return disk.failed, old, new, there


def disk_full(world: World) -> None:
    """The disk is full or broken at any call: the save fails whole and says so."""
    number = int(world.random.choice([errno.ENOSPC, errno.EIO]))
    _, old, new, there = _saved(world, OSError(number, os.strerror(number)))
    world.claim(there in (old, new), "neither old nor new")


def power_cut(world: World) -> None:
    """The power goes at any call: old or new, never mixed."""
    failed, old, new, there = _saved(world, PowerCut())
    world.claim(there in ((old, new) if failed else (new,)), "neither old nor new")


def client_dies(world: World) -> None:
    """Its connection closes, or it falls silent, in motion: hold, and a new lease for others."""
    rig = world.moving()
    closes = bool(world.random.random() < 0.5)
    world.begun = world.now
    if closes:
        rig.front.outer.send(link.encode(link.ConnectionClosed(client=7)))
        world.detected(0.03)
        held = world.begun + 0.03
    else:
        world.stream()
        world.detected(0.25 + 0.02, since=world.begun, codes=("LEASE_LOST", "STREAM_STALE"))
        held = world.begun + 0.27
    world.holds(held + BRAKE)
    world.claim(not rig.loop.condition.latches, f"latched {sorted(rig.loop.condition.latches)}")
    reply = world.call(link.AcquireLease, client=9)
    world.claim(reply.error is None, "the lease is not free")
    rig.front.outer.send(link.encode(link.ConnectionClosed(client=9)))
    world.ticks(3)
    world.joint = int(world.random.integers(24))
    world.move()
    world.goes_on()


def second_client(world: World) -> None:
    """Another wants to move, stream or take the lease: refused, and the motion of the first goes on."""
    rig = world.moving()
    since = world.now
    kinds: list[tuple[type[link.Command], dict[str, Any]]] = [
        (link.AcquireLease, {}),
        (link.RenewLease, {}),
        (link.Setpoint, {"joints": [0], "positions": [0.1]}),
        (link.Arm, {}),
    ]
    kind, given = kinds[int(world.random.integers(len(kinds)))]
    reply = world.call(kind, client=8, **given)
    world.claim(reply.error is not None, f"{kind.__name__} of another client was accepted")
    path = rig.path("head_yaw", [0.3], [1.0])
    ticket = rig.submit(path, client=8)
    world.ticks(4)
    answers = rig.replies(ticket)
    world.claim(bool(answers) and answers[-1].error is not None, "another client's trajectory was accepted")
    world.begun = since
    world.goes_on()
    world.outcome.delay = 0.0


def no_memory(world: World) -> None:
    """Memory cannot be had in one or two ticks: told, the last goal is held with torque."""
    rig = world.moving()
    update = rig.loop.parts.twin.update
    left = int(world.random.integers(1, 3))

    def failing(*given: Any) -> Any:
        nonlocal left
        left -= 1
        if left >= 0:
            raise MemoryError
        return update(*given)

    rig.loop.parts.twin.update = failing  # type: ignore[method-assign]
    world.begun = world.now
    world.detected()
    world.holds(world.begun + 0.03 + 0.2)
    world.latched()
    world.stays_so()
    world.recover()


def nan_in_the_model(world: World) -> None:
    """The simulation, or the mirror, holds no number any more: nothing of it reaches a servo."""
    rig = world.moving()
    which = str(world.random.choice(["simulation", "mirror"]))
    parts = {name: part for name, part in vars(rig.loop.parts.twin).items() if hasattr(part, "data")}
    assert parts, sorted(vars(rig.loop.parts.twin))
    part = next((part for name, part in parts.items() if which in name), next(iter(parts.values())))
    value = float(world.random.choice([np.nan, np.inf, 1e300]))
    part.data.qpos[int(world.random.integers(7, len(part.data.qpos)))] = value
    world.begun = world.now
    world.seconds(1.0)
    goal = world.trace.goal(world.begun)
    world.claim(bool((np.abs(np.diff(goal, axis=0)) <= 28).all()), "a goal jumped")
    world.torque_stays()
    world.claim(bool(np.isfinite(rig.loop.robot.measured.position).all()), "a reading is no number")
    world.claim(bool(np.isfinite(rig.loop.parts.twin.mirror.position).all()), "the mirror shows no number")
    world.claim(bool(np.isfinite(rig.loop.robot.simulated.position).all()), "the simulation shows no number")


def storm_of_events(world: World) -> None:
    """Nobody takes the news while faults make many: the tick goes on, what is lost is counted."""
    rig = world.moving()
    # type: ignore[method-assign]
    rig_collect = rig.collect_news
    rig.collect_news = lambda: None
    missed = rig.loop.figures.missed
    world.begun = world.now
    for _ in range(20):
        world.obey({"fault": "corrupt", "count": 30})
        world.seconds(0.2)
    rig.collect_news = rig_collect  # type: ignore[method-assign]
    world.ticks(3)
    world.claim(rig.loop.figures.missed == missed, "ticks were missed")
    news = [each for each in rig.news if isinstance(each, link.Tick)]
    numbers = np.diff([each.sequence for each in news])
    dropped = sum(each.dropped for each in news[-5:])
    world.claim(not (numbers > 1).any() or dropped > 0, "telemetry was lost and not counted")


ROWS = (
    Fault(26, "SIGTERM, twice", (), 0.0, "lowered, off, ends", terminated, also=("STATE_STALE",)),
    Fault(27, "front hangs", ("LEASE_LOST",), 1.02, "tick goes on; hold", front_hangs),
    Fault(31, "disk full or broken", (), 0.0, "a save fails whole", disk_full),
    Fault(32, "power goes while saving", (), 0.0, "old or new", power_cut),
    Fault(34, "client dies in motion", ("LEASE_LOST", "STREAM_STALE"), 0.27, "hold", client_dies),
    Fault(
        35,
        "two clients, two daemons",
        (),
        0.0,
        "refused, the first goes on",
        second_client,
        also=("LEASE_MISSING",),
    ),
    Fault(36, "memory or descriptors exhausted", ("INTERNAL",), 0.03, "hold with torque", no_memory),
    Fault(
        39,
        "no numbers in the model",
        (),
        0.0,
        "no goal of it",
        nan_in_the_model,
        also=("MIRROR_DRIFT", "INTERNAL"),
    ),
    Fault(
        40,
        "nobody takes the news",
        (),
        0.0,
        "tick goes on, counted",
        storm_of_events,
        also=("RX_SHAPE", "BUS_ERRORS", "FOREIGN_TRAFFIC", "LEASE_LOST", "STATE_STALE"),
    ),
)
