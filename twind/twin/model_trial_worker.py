"""Process of a model's trial, started by `twind/config/model_trial.py`: compiles one model, then ends."""

import json
import sys

from twind.bounded_process import read_request, refusal
from twind.exceptions import InvalidInput


def main() -> None:
    """Answer one request."""
    request = read_request()
    import mujoco  # noqa: PLC0415 - within the bounds

    answer: object = {}
    try:
        mujoco.MjData(mujoco.MjSpec.from_file(request["path"]).compile())
    except ValueError as error:
        answer = refusal(InvalidInput(f"{error}; correct it", where=request["path"]))
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
