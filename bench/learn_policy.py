"""`learn.policy_p99`: what a policy takes for an observation, beside what others use; and a whole step."""

import tempfile
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_per_call,
    interleaved,
    quantile,
)
from twind.command_line.extras import how_to_add

WIDTHS = (128, 256, 256, 24)  # h24's observation, two layers, its joints
CALLS = 2000  # a round
WARM = 200


def policy_p99() -> Mapping[str, MeasuredFigure]:
    """Wall time of one observation, p99, ms; one thread each, the same weights."""
    try:
        import onnxruntime
        import torch
        from threadpoolctl import threadpool_limits

        from twind.config.robot_file import load_robot
        from twind.learn.policy.policy_file import NetworkLayer, PolicyCard, load, save
        from twind.learn.task.action_shaping import ActionShaping
        from twind.learn.task.plant_model import plant_of
    except ImportError as missing:
        raise MeasurementUnavailable(f"{missing}: {how_to_add('learn')}") from None
    plant = plant_of(load_robot("h24-standing"), period=0.02)
    layers = [NetworkLayer(*each) for each in _network()]
    card = PolicyCard.for_training(
        "Stand",
        "h24-standing",
        plant.layout,
        plant.binding.limits,
        plant.default,
        ActionShaping(),
        trained_steps=0,
    )
    zero = np.zeros(WIDTHS[0], np.float32)
    one = np.ones(WIDTHS[0], np.float32)
    with tempfile.TemporaryDirectory(prefix="twind-bench-") as folder, threadpool_limits(limits=1):
        path = Path(folder) / "policy.onnx"
        save(path, layers, zero, one, 10.0, card)
        policy = load(path)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        torch.set_num_threads(1)
        eager = _eager(torch, layers)
        ways: dict[str, Callable[[Any], Any]] = {
            "twind": policy.act,
            "onnxruntime": lambda seen: session.run(None, {"observation": seen[None]}),
            "torch eager": eager,
        }
        found = interleaved(ROUNDS, {name: _p99(act) for name, act in ways.items()})
        step = _step(policy, plant)
    p99 = {name: median(values) for name, values in found.items()}
    shape = "-".join(map(str, WIDTHS))
    note = f"{shape}, tanh; all of a controller's step, state to setpoint: {step * 1e6:.0f} µs of CPU"
    peers = {name: value for name, value in p99.items() if name != "twind"}
    return {"learn.policy_p99": MeasuredFigure(p99["twind"], note, peers)}


def _network() -> list[tuple[Any, Any, str]]:
    rng = np.random.default_rng(0)
    return [
        (
            rng.normal(0.0, into**-0.5, (out, into)).astype(np.float32),
            np.zeros(out, np.float32),
            "none" if out == WIDTHS[-1] else "tanh",
        )
        for into, out in pairwise(WIDTHS)
    ]


def _eager(torch: Any, layers: list[Any]) -> Callable[[Any], Any]:
    """As a training script has it: numpy in, numpy out."""
    parts = []
    for layer in layers:
        linear = torch.nn.Linear(layer.weight.shape[1], layer.weight.shape[0])
        linear.weight.data = torch.from_numpy(layer.weight)
        linear.bias.data = torch.from_numpy(layer.bias)
        parts += [linear] if layer.activation == "none" else [linear, torch.nn.Tanh()]
    network = torch.nn.Sequential(*parts)

    def act(seen: Any) -> Any:
        with torch.inference_mode():
            return network(torch.from_numpy(seen).clamp(-10.0, 10.0)).clamp(-1.0, 1.0).numpy()

    return act


def _p99(act: Callable[[Any], Any]) -> Callable[[], float]:
    rows = np.random.default_rng(1).normal(size=(WARM + CALLS, WIDTHS[0])).astype(np.float32)

    def take() -> float:
        times = []
        for row in rows:
            began = time.perf_counter()
            act(row)
            times.append(time.perf_counter() - began)
        return quantile(times[WARM:], 0.99) * 1e3

    return take


def _step(policy: Any, plant: Any) -> float:
    """CPU (s) from the parameters of a state message to the setpoint that is sent."""
    from twind.learn.live.base_estimator import BaseEstimator
    from twind.learn.policy.policy_actor import TrainedActor
    from twind.learn.policy.policy_controller import PolicyController
    from twind.learn.task.learning_tasks import task_of
    from twind.learn.task.reward import RewardFunction
    from twind.robot_client.state_message import decode_state_message

    task = task_of("Stand")
    names = plant.layout.joints
    controller = PolicyController(
        TrainedActor(policy, task),
        BaseEstimator(plant),
        RewardFunction(task, plant).fallen,
        np.zeros(3),
        lambda: 0.0,
    )
    joints = [
        {"name": name, "position": at, "velocity": 0.0, "goal": at, "age_ms": 1.0}
        for name, at in zip(names, plant.default.tolist(), strict=True)
    ]
    imu = {"gyro": [0.0] * 3, "acceleration": [0.0, 0.0, 9.8], "quaternion": [1.0, 0, 0, 0], "age_ms": 1.0}
    answer = {"time": 0.0, "sequence": 0, "joints": joints, "imu": imu}

    def one(_number: int) -> None:
        controller.step(decode_state_message(answer, 0.0, names), 0.0)
        controller.record_acceptance()

    return cpu_per_call(one, CALLS)


MEASUREMENTS = (Measurement({"learn.policy_p99": FigureSpec("ms", "≤ 0.5")}, policy_p99),)
