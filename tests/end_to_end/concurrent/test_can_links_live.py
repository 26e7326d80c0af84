"""Real-time tests of doctor can links."""

import os
import subprocess
import sys

from tests.support.doctor_rig import found

LEGS = ("--robot", "h24-mixed", "--port", "l_leg=can:socketcan:can0")


def test_who_owns_an_interface_is_named_though_it_has_no_node() -> None:
    name = f"doct{os.getpid()}"
    program = (
        "from twind_drivers.can.can_interface_lock import CanInterfaceLock; sign = "
        f"CanInterfaceLock({name!r}); print(flush=True); input()"
    )
    words = (*LEGS[:2], "--port", f"l_leg=can:socketcan:{name}")
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "\n"
        (finding,) = found(*words, code="PORT_HELD")
        assert (finding.thing, finding.command) == (name, "")
        assert f"`ps -fp {other.pid}`" in finding.advice
        assert f"pid {other.pid} (" in finding.measured
        other.communicate("\n")
    assert found(*words, code="PORT_HELD") == []
