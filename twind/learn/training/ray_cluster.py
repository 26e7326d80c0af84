"""The Ray cluster of a training: one that runs, or one of this machine's processes that ends with it.

Ray's own data collection and dashboard are off. A cluster of this machine listens on loopback, and asks for a
token that its processes alone have: whoever reaches an open one runs programs on it.
"""

import os
import secrets
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from twind.exceptions import OperationFailed
from twind.learn.training.training_settings import TrainingSettings

LOCAL = "local"
STORE = 200 << 20  # bytes of /dev/shm, of a local cluster: a rollout of 1000 environments
REACHED = 5.0  # s, to connect; Ray itself tries for minutes
QUIET = {"log_to_driver": False, "logging_level": "ERROR"}


@contextmanager
def ray_workers(address: str, count: int | None, settings: TrainingSettings) -> Iterator[Any]:
    """Yield the `RolloutWorkers` of a training on the cluster at `address`: `local`, `auto` or HOST:PORT.

    `count`: None, one for each core of the cluster; never more than there are environments.
    Raises OperationFailed: no such cluster, or no worker that starts.
    """
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else it warns that this will change
    folder = None
    if address not in (LOCAL, "auto"):
        _require_listener(address)
    if address == LOCAL:
        folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp")  # sockets in it: their paths have 107 bytes
    try:
        _connect(address, folder, count)
        import ray

        from twind.learn.training.rollout_workers import RolloutWorkers

        cores = int(ray.cluster_resources().get("CPU", 0))
        if not cores:
            raise OperationFailed(f"Ray at {address}: no worker: the cluster has no core")
        yield RolloutWorkers(settings, min(count or cores, settings.envs))
    finally:
        _disconnect(folder)


def _connect(address: str, folder: str | None, count: int | None) -> None:
    if folder is not None:
        # By its name for other systems: 127.0.0.1 stays what it is, and all servers listen there alone.
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    import ray

    local: dict[str, Any] = {
        "num_cpus": max(count or 1, len(os.sched_getaffinity(0))),
        "include_dashboard": False,
        "object_store_memory": STORE,
        "_node_ip_address": "127.0.0.1",
        "_temp_dir": folder,
    }
    try:
        ray.init(**QUIET, **(local if folder is not None else {"address": address}))
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise OperationFailed(f"Ray at {address}: {' '.join(str(error).split())[:200]}") from None


def _require_listener(address: str) -> None:
    """Raises OperationFailed: nothing answers there, or it is no address."""
    host, colon, port = address.rpartition(":")
    if not colon or not host or not port.isdecimal():
        raise OperationFailed(f"--ray {address}: local, auto or HOST:PORT is needed")
    try:
        socket.create_connection((host, int(port)), REACHED).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OperationFailed(
            f"Ray at {address}: {reason}; is `ray start --head --port {port}` running on {host}?"
        ) from None


def _disconnect(folder: str | None) -> None:
    import ray

    ray.shutdown()
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
