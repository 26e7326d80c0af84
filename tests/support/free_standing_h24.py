"""The h24 that stands on its own feet: the built-in robot file with `support: free`, beside its model."""

from importlib import resources
from pathlib import Path


def free_h24(folder: Path, **changes: str) -> Path:
    """The file, in `folder`; `changes` replace text: old=new by pairs of names `was`, `now`."""
    source = Path(str(resources.files("twind.robots")))
    (folder / "h24.xml").write_text((source / "h24.xml").read_text())
    text = (source / "h24.yaml").read_text().replace("support: gantry", "support: free")
    assert "support: free" in text
    if changes:
        assert changes["was"] in text
        text = text.replace(changes["was"], changes["now"])
    path = folder / "free.yaml"
    path.write_text(text)
    return path
