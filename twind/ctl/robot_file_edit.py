"""Edits of a robot file that leave all else as it is: comments, order and spacing."""

import os
import stat
from pathlib import Path
from typing import Any

import yaml

from twind.command_line.verb import Rejected
from twind.config.robot_file import read_robot
from twind.config.yaml_tree import ConfigError, read_text
from twind.new_file import unwritten, write_new

TODO_COMMENT = "# What no source states: mode live is refused until `twindctl robot finish` has settled it."


class RobotFileEdit:
    """The text of a robot file, edited key by key and written as a whole."""

    def __init__(self, path: Path) -> None:
        """Read the file. Raises ConfigError."""
        self.path = path.resolve()  # a link stays one
        self.text = self._known = read_text(path)

    def put(self, key: str, value: str) -> None:
        """Set `a.b.c` to a value written as YAML; a missing key is added to its section."""
        parts = key.split(".")
        node = self._find(parts)
        if node is not None:
            self._replace(node.start_mark.index, node.end_mark.index, value)
            return
        above = self._find(parts[:-1])
        if not isinstance(above, yaml.MappingNode) or not above.value:
            raise Rejected(f"{self.path}: {key}: there is no section {'.'.join(parts[:-1])}")
        first_key, _ = above.value[0]
        begin = first_key.start_mark.index  # the end of a block of YAML is the beginning of what follows it
        gap = ", " if above.flow_style else "\n" + " " * first_key.start_mark.column
        self._replace(begin, begin, f"{parts[-1]}: {value}{gap}")

    def settle(self, item: str) -> None:
        """Remove an item of `todo`; with its last item the key and its comment."""
        root: Any = yaml.compose(self.text, yaml.SafeLoader)
        pair = next((pair for pair in root.value if pair[0].value == "todo"), None)
        if pair is None:
            return
        left = [each.value for each in pair[1].value if each.value != item]
        begin = pair[0].start_mark.index
        end = pair[1].end_mark.index
        body = "todo:\n" + "".join(f"  - {each}\n" for each in left) if left else ""
        tail = self.text[end:].lstrip("\n") if not left else self.text[end:]
        if not left and self.text[:begin].endswith(f"{TODO_COMMENT}\n"):
            begin -= len(TODO_COMMENT) + 1
        gap = "\n" if left and not tail.startswith("\n") else ""
        self.text = self.text[:begin] + body + gap + tail

    def save(self) -> None:
        """Replace the file: the old text or the new one, never mixed.

        Raises Rejected: it is not replaced, as it cannot be, or another program has changed it meanwhile.
        """
        try:
            self._save()
        except OSError as error:
            raise Rejected(f"{self.path} cannot be written: {unwritten(error)}") from None
        self._known = self.text

    def _save(self) -> None:
        if self.path.read_bytes() != self._known.encode():
            raise Rejected(
                f"{self.path} was changed since it was read, and is left as it is: run the command again"
            )
        fresh = self.path.with_name(f".{self.path.stem}.new.yaml")
        try:
            write_new(fresh, self.text.encode())
            try:
                read_robot(fresh)
            except ConfigError as error:
                raise Rejected(str(error).replace(fresh.name, self.path.name)) from None
            status = self.path.stat()
            fresh.chmod(stat.S_IMODE(status.st_mode))
            if (status.st_uid, status.st_gid) != (fresh.stat().st_uid, fresh.stat().st_gid):
                os.chown(fresh, status.st_uid, status.st_gid)
            _sync(fresh)
            os.replace(fresh, self.path)
            _sync(self.path.parent)
        finally:
            fresh.unlink(missing_ok=True)

    def _find(self, parts: list[str]) -> Any:
        node = yaml.compose(self.text, yaml.SafeLoader)
        for part in parts:
            pairs = node.value if isinstance(node, yaml.MappingNode) else []
            node = next((value for key, value in pairs if key.value == part), None)
            if node is None:
                return None
        return node

    def _replace(self, begin: int, end: int, text: str) -> None:
        self.text = self.text[:begin] + text + self.text[end:]


def _sync(path: Path) -> None:
    """Put a file, or the names in a folder, on the disk."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
