"""A stage for situations of the whole loop: real bytes, virtual servos, a fake clock, and what was told."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.daemon_rig import CLIENT, Rig
from twind import link
from twind.robot.finding import ReasonCode
from twind.robot.modes import Motion

Told = Iterable[str]
Scene = Callable[[Rig], None]
SCENES: dict[ReasonCode, Callable[[Path], Told]] = {}


@contextmanager
def rig(**how: Any) -> Iterator[Rig]:
    made = Rig(**how)
    try:
        yield made
    finally:
        made.close()


def reported_codes(made: Rig) -> set[str]:
    """Reason codes that left the loop: in events, replies and latches."""
    found: set[str] = set()
    for news in made.news:
        if isinstance(news, link.Event):
            found |= {news.code, *(str(finding.code) for finding in news.findings)}
        elif isinstance(news, link.Reply):
            found |= {finding["code"] for finding in (news.parameters or {}).get("findings", ())}
        elif isinstance(news, link.Overview):
            found |= {str(finding.code) for finding in news.faults}
    return found & {code.value for code in ReasonCode}


def leads_to(code: ReasonCode, *, arm: bool = True, **how: Any) -> Callable[[Scene], Scene]:
    """Keep a situation of a robot that is armed, or only connected."""

    def keep(scene: Scene) -> Scene:
        def run(_: Path) -> Told:
            with rig(**how) as made:
                if arm:
                    made.arm()
                before = reported_codes(made)
                assert code not in before, f"{code} was reported before the scene began"
                scene(made)
                return reported_codes(made)

        run.__name__ = scene.__name__
        assert code not in SCENES, code
        SCENES[code] = run
        return scene

    return keep


def move(made: Rig, joint: str = "head_yaw", to: float = 1.0, seconds: float = 4.0, **more: Any) -> None:
    made.lease()
    made.submit(made.path(joint, [to], [seconds]), more=True, **more)
    made.ticks(20)
    assert made.loop.executor.motion is Motion.ACTIVE, made.news[-3:]


def ask(made: Rig, client: int = CLIENT) -> None:
    """A small motion, refused or not."""
    made.submit(made.path("head_yaw", [0.2], [1.0]), client=client)
    made.ticks(3)


def faults(made: Rig) -> Any:
    return made.virtual["main"].faults
