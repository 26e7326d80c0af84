"""One ONNX model in onnxruntime, with bounds: no other file, no second thread, limited memory and time.

A model may come from an untrusted source. Its memory is bounded by the process that it runs in
(`limit_memory`), its time by `ending_long_inferences`.
"""

import resource
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twind.exceptions import InvalidInput

Rows = NDArray[np.float32]
INPUT = "observation"
OUTPUT = "action"
MEMORY = 512 << 20  # bytes that a process may take for a model; the network of 24 joints takes 1 MB
LONGEST = 1.0  # s of one inference; the gate brakes after 0.06 s without a setpoint
_FATAL = 4  # log severity: every lesser error is an exception too
_SHOWN = 300  # characters of an error of onnxruntime


class TensorEnd(NamedTuple):
    """One input or output of a model."""

    name: str
    type: str  # as onnxruntime writes it: "tensor(float)"
    shape: list[int | str | None]  # str, None: dynamic


class OnnxSession:
    """A loaded model. For one thread at a time."""

    def __init__(self, data: bytes, beside: Mapping[str, bytes] | None = None) -> None:
        """Load a model; no operation of it runs. Raises InvalidInput where onnxruntime cannot load it.

        `beside`: contents of the files that it may store arrays in, by name. No other file is read.
        """
        import onnxruntime

        try:
            options = _options(onnxruntime)
            if beside:
                stored = list(beside.values())
                options.add_external_initializers_from_files_in_memory(
                    list(beside), stored, [len(each) for each in stored]
                )
            self._session: Any = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
            self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
            self.inputs = [TensorEnd(each.name, each.type, each.shape) for each in self._session.get_inputs()]
            self.outputs = [
                TensorEnd(each.name, each.type, each.shape) for each in self._session.get_outputs()
            ]
        except Exception as error:  # noqa: BLE001  the exceptions of onnxruntime have no common class
            raise InvalidInput(f"is no ONNX model that can be run: {_reason(error)}") from None
        self._run_options = onnxruntime.RunOptions()
        self._run_options.log_severity_level = _FATAL
        self._began: float | None = None  # s, monotonic: start of the inference that runs now

    def require_shapes(self, observations: int, actions: int) -> None:
        """Require `observation` (batch, N) and `action` (batch, n) alone, float32. Raises InvalidInput."""
        _require_end("input", INPUT, observations, self.inputs)
        _require_end("output", OUTPUT, actions, self.outputs)

    def run(self, observation: Rows) -> Rows:
        """Return the actions (batch, n) for observations (batch, N), NaN where the network makes NaN.

        Raises InvalidInput where an operation fails or the inference is ended.
        """
        if len(observation) > 1 and self.inputs[0].shape[0] == 1:
            return np.concatenate([self.run(row) for row in observation[:, None]])
        return self.infer([OUTPUT], {INPUT: observation})[0]

    def infer(self, outputs: Sequence[str], feeds: Mapping[str, Rows]) -> list[Rows]:
        """Return `outputs` for the arrays of all inputs. Raises InvalidInput as `run` does."""
        self._run_options.terminate = False
        self._began = time.monotonic()
        try:
            found: list[Rows] = self._session.run(outputs, feeds, self._run_options)
        except Exception as error:  # noqa: BLE001  the exceptions of onnxruntime have no common class
            if self._run_options.terminate:
                reason = f"took more than {LONGEST:g} s, the bound of a policy"
            else:
                reason = f"failed: {_reason(error)}"
            raise InvalidInput(f"its inference {reason}") from None
        finally:
            self._began = None
        return found

    @contextmanager
    def ending_long_inferences(self) -> Iterator[None]:
        """End each inference that takes longer than `LONGEST`, from a second thread."""
        stop = threading.Event()

        def watch() -> None:
            while not stop.wait(LONGEST / 4):
                began = self._began
                if began is not None and time.monotonic() - began > LONGEST:
                    self._run_options.terminate = True

        thread = threading.Thread(target=watch, name="inference limit", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def limit_memory() -> None:
    """Limit the memory of this process to what it has now and `MEMORY` more."""
    with open("/proc/self/statm", encoding="ascii") as file:
        pages = int(file.read().split()[5])
    limit = pages * resource.getpagesize() + MEMORY
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    if hard == resource.RLIM_INFINITY or limit < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def _options(onnxruntime: Any) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Constant folding runs operations while the model loads, where no inference can be ended.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.enable_cpu_mem_arena = False  # it keeps the memory of the largest inference
    options.log_severity_level = _FATAL
    # The folder of arrays that are stored in other files: none, so that no other file is read.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", "/dev/null")
    return options


def _require_end(what: str, name: str, count: int, ends: list[TensorEnd]) -> None:
    names = [end.name for end in ends]
    if names != [name]:
        found = ", ".join(each[:40] for each in names[:4]) or "none"
        raise InvalidInput(f"its {what} is {found}, {name} alone is needed: name it so in the export")
    if ends[0].type != "tensor(float)":
        raise InvalidInput(f"its {what} {name} is a {ends[0].type}, float32 is needed: cast it in the export")
    shape = ends[0].shape
    batch = shape[0] if shape else 0
    if len(shape) != 2 or shape[1] != count or not (batch == 1 or batch is None or isinstance(batch, str)):
        raise InvalidInput(
            f"its {what} {name} has the shape {shape}, its card says (batch, {count}): "
            "export it with that shape, the batch 1 or dynamic"
        )


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError) or "bad_alloc" in text:
        return f"it needs more than {MEMORY >> 20} MiB of memory, the bound of a policy"
    if "xternal data" in text:
        return "it stores arrays in another file than NAME.onnx.data beside it: export it as one file"
    return text[:_SHOWN]
