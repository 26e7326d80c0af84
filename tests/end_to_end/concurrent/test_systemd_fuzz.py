"""Local users without rights of root attack the service under its unit: it answers, and nothing of it breaks.

`-m campaign` sends 50,000 frames to each socket.
"""

import contextlib
import threading
import time
from collections.abc import Iterator

import pytest

from tests.proof.fuzz.frames import GROWTH, resident
from tests.support.systemd.installed import OPT
from tests.support.systemd.machine import Machine
from tests.support.systemd.service import Service, settings
from twind.client import CallError, ClientError

HANG = 3600.0  # s until a run of any length counts as hung
EVERY = 0.4  # s between news
PATH = {"joint_names": ["nobody"], "points": []}
USERS = {"control": "pilot", "observe": "watcher"}  # who may open which socket


@pytest.fixture(scope="module")
def simulated(machine: Machine) -> Iterator[Service]:
    """The service in mode sim, with a robot that its clients may move."""
    written = settings(machine, "twind", {"mode": "sim"})
    service = Service(machine).start()
    service.reach(mode="sim")
    yield service
    service.stop()
    written.unlink()


@contextlib.contextmanager
def news(service: Service) -> Iterator[None]:
    """An event and a verdict now and then: some calls are answered by nothing else."""
    over = threading.Event()

    def cause() -> None:
        while not over.wait(EVERY):
            with contextlib.suppress(ClientError), service.client() as client:
                client.call("Mark", kind="note", text="news")
                with contextlib.suppress(CallError):
                    client.call("SubmitTrajectory", trajectory=PATH)

    thread = threading.Thread(target=cause)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def attack(service: Service, name: str, user: str, count: int) -> str:
    """Send so many frames as that user; the summary."""
    frames = ("-m", "tests.proof.fuzz.service_frames", service.sockets, name, str(count), "28")
    python = ("env", f"PYTHONPATH={OPT}", "PYTHONDONTWRITEBYTECODE=1", f"{OPT}/bin/python")
    with news(service):
        done = service.machine.try_run(*python, *frames, user=user, seconds=HANG)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def faults(service: Service, since: float) -> str:
    """Lines of its journal since then that tell of a call or a process that broke."""
    lines = f"journalctl --no-pager -o cat -u {service.unit} --since=@{since:.6f}"
    command = f"{lines} | grep -E 'CALL_BROKE|Traceback|INTERNAL' || true"
    return service.machine.run("sh", "-c", command, seconds=HANG)


@pytest.mark.parametrize("count", [150, pytest.param(50_000, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("name", USERS)
def test_no_frames_of_a_local_user_break_the_service(simulated: Service, name: str, count: int) -> None:
    begun = time.time()
    main = simulated.main()
    front = simulated.front()
    assert front is not None
    attack(simulated, name, USERS[name], min(count, 1000))
    before = [resident(main), resident(front)]
    print(attack(simulated, name, USERS[name], count))
    assert (simulated.main(), simulated.front()) == (main, front), "a process was replaced"
    grown = [now - then for now, then in zip([resident(main), resident(front)], before, strict=True)]
    assert max(grown) < GROWTH, f"loop and front grew by {grown} bytes"
    simulated.until(ActiveState="active", NRestarts="0")  # a call may just have begun a reload
    assert faults(simulated, begun) == ""
    ticks = simulated.status()["loop"]["ticks"]
    simulated.machine.until(lambda: simulated.status()["loop"]["ticks"] > ticks, 5.0, "the next tick")


def test_a_user_of_no_group_reaches_neither_socket(simulated: Service) -> None:
    code = "import socket, sys\nsocket.socket(socket.AF_UNIX).connect(sys.argv[1])"
    for name in USERS:
        command = [f"{OPT}/bin/python", "-c", code, f"{simulated.sockets}/{name}.sock"]
        done = simulated.machine.try_run(*command, user="stranger")
        assert done.returncode == 1 and done.stderr.splitlines()[-1].startswith("PermissionError"), done
