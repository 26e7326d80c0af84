"""Process of a model's trial, started by `twind/config/model_trial.py`: compiles one model, then ends."""

import json
import sys

from twind.bounded_process import read_request, refusal
from twind.exceptions import InvalidInput


def main() -> None:
    """Answer one request."""
    request = read_request()
    import mujoco  # noqa: PLC0415 - within the bounds

    from twind.twin.model_from_text import compile_text  # noqa: PLC0415 - imports it too

    answer: object = {}
    try:
        if "path" in request:
            model = mujoco.MjSpec.from_file(request["path"]).compile()
        else:
            model = compile_text(request["mjcf"], request["folder"], files_left_out=request["files_left_out"])
        mujoco.MjData(model)
    except ValueError as error:
        answer = refusal(InvalidInput(f"{error}; correct it"))
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
