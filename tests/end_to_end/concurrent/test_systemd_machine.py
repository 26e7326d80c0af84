"""The machine of the tests itself: where it cannot be had that is said, and nothing of it is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.systemd import machine as machines
from tests.support.systemd.machine import Machine

# A run of tests in small: its last words before it waits are its init and its cgroup.
RUN = """
import signal, sys, time
from tests.support.systemd.machine import Machine
signal.signal(signal.SIGINT, signal.default_int_handler)  # who starts these tests may have it ignored
machine = Machine(lambda tree: None, {})
try:
    machine.boot()
    machine.popen("sleep", "60")
    print(machine.init, machine.cgroup("/"), machine.folder, flush=True)
    time.sleep(60)
finally:
    machine.down()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_of_it_however_the_tests_end(machine: Machine, number: signal.Signals) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    with subprocess.Popen(
        [sys.executable, "-c", RUN], env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as run:
        assert run.stdout is not None
        init, cgroup, folder = run.stdout.readline().decode().split()
        assert Path("/proc", init).exists() and Path(cgroup, "cgroup.procs").exists()
        run.send_signal(number)
        run.wait(10)
    deadline = time.monotonic() + 5.0
    while Path("/proc", init).exists():
        assert time.monotonic() < deadline, "its init lives on"
        time.sleep(0.01)
    unified = machines.cgroup2()
    assert unified is not None
    while Path(cgroup).exists():  # of killed tests: removed by the next
        assert number == signal.SIGKILL, "its cgroup is left"
        assert time.monotonic() < deadline, "its cgroup is not removed by the next either"
        machines.sweep(unified)
    assert not Path(folder).exists()
    assert folder not in Path("/proc/mounts").read_text()


def test_an_unavailable_test_machine_reports_the_reason(machine: Machine) -> None:
    asked = [sys.executable, "-c", "from tests.support.systemd import machine; print(machine.why_not())"]
    for without, said in (
        (["--reuid", "65534", "--clear-groups"], "a private systemd needs root"),
        (["--inh-caps", "-all", "--bounding-set", "-sys_admin"], "namespaces are not allowed here"),
    ):
        done = subprocess.run(
            ["setpriv", *without, "env", f"PYTHONPATH={Path(__file__).parents[3]}", *asked],
            capture_output=True,
            text=True,
            timeout=20,
        )
        # An interpreter that only root may enter cannot be asked as somebody else.
        assert done.stdout.startswith(said) or "Permission denied" in done.stderr, done
    assert machines.why_not() is None
