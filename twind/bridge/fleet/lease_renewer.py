"""Renewal of a remote robot's lease, whether or not the answers come quickly."""

import json
import time
from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.robot_endpoint import RemoteRobotEndpoint
from twind.bridge.zenoh.zenoh_keys import LEASE_S

MISSING = "LEASE_MISSING"  # the finding that a lease is not held
RENEWED = 0.3 * LEASE_S  # s between two; each is sent whether the one before was answered or not


class LeaseRenewer:
    """Renewer of a Grant. `lost`: why the lease has ended. `confirmed`: s, monotonic, last confirmation."""

    def __init__(self, reach: RemoteRobotEndpoint, grant: Mapping[str, Any], came: float) -> None:
        """Make the renewer; `came`: s, monotonic, arrival of the grant."""
        self._reach = reach
        self.id = str(grant["lease"])
        self._robot_time = float(grant["now"])
        self._came = came
        self.confirmed = came
        self._due = came + RENEWED
        self.lost = ""

    def deadline(self, now: float) -> float:
        """Return the end of a lease renewed now, s of the robot's clock.

        Early by the way of the grant, never late.
        """
        return self._robot_time + (now - self._came) + LEASE_S

    def renew_if_due(self, now: float) -> float:
        """Renew it when it is due; s until it is due again."""
        if now >= self._due and not self.lost:
            self._due = now + RENEWED
            self._reach.ask(
                ("lease",), {"op": "renew", "lease": self.id}, 5.0 * LEASE_S, self._renewed, lambda: None
            )
        return max(0.0, self._due - now)

    def _renewed(self, message: bytes) -> None:
        """Process an answer.

        Only a report of a lost lease ends it: a busy robot may renew at the next request.
        """
        try:
            answer = json.loads(message)
            error = answer.get("error")
            codes = [each.get("code") for each in answer["parameters"].get("findings") or ()]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return  # not valid: it confirms nothing
        if not error:
            self.confirmed = time.monotonic()
        elif MISSING in codes:
            self.lost = str(error)
