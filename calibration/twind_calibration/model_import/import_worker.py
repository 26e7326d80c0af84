"""Process of one import, started by `import_model.py`: a request goes in, the imported model comes out."""

import json
import os
import sys
from pathlib import Path

import msgspec

from twind.bounded_process import read_request, refusal
from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import import_refused
from twind_calibration.model_import.model_reading import read_model


def main() -> None:
    """Answer one request."""
    request = read_request()
    try:
        model = read_model(
            Path(request["path"]),
            Path(request["folder"]),
            floating=request["floating"],
            packages={name: Path(folder) for name, folder in request["packages"].items()},
            arguments=request["arguments"],
            environment=os.environ,
        )
        answer: object = {"model": msgspec.to_builtins(model, enc_hook=str)}
    except InvalidInput as error:
        answer = refusal(error)
    except OSError as error:  # the folder cannot be written
        answer = refusal(import_refused(f"{error.strerror}; name another folder", where=str(error.filename)))
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
