"""Writer of manual pages and completion scripts: `python -m twind.manual.write_manuals FOLDER`.

`packaging/install.sh` runs it in the installed environment and links its files to their places:
`NAME.SECTION`, `bash/NAME` and `zsh/_NAME`.
"""

import sys
from pathlib import Path

from twind.manual.argument_parsers import programs
from twind.manual.completion_script import completion_script
from twind.manual.man_page import man_page


def write_manuals(folder: Path) -> None:
    """Write the files of all programs. Makes the folder. Raises OSError."""
    for shell in ("bash", "zsh"):
        (folder / shell).mkdir(parents=True, exist_ok=True)
    for program in programs():
        name = program.name
        (folder / f"{name}.{program.section}").write_text(man_page(program), encoding="utf-8")
        (folder / "bash" / name).write_text(completion_script(program.parser, "bash"), encoding="utf-8")
        (folder / "zsh" / f"_{name}").write_text(completion_script(program.parser, "zsh"), encoding="utf-8")


if __name__ == "__main__":
    write_manuals(Path(sys.argv[1]))
