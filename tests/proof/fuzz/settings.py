"""Settings and cards of policies that nobody should write: a ConfigError that says where, in bounded time."""

import tempfile
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from random import Random

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.yaml_text import is_accepted, mutated_yaml
from tests.support.card_files import COUNTER, HEAD, PLAIN, STANDING, STANDING_LSTM
from twind.config.daemon_settings import load_settings
from twind.learn.cards.interface_card import parse_card

SETTINGS = (
    "mode: live\nrobot: h24\nindividual: anna-1\ncalibration: a.yaml\nports: {main: /dev/ttyUSB0}\n"
    "rate_hz: 100.0\nsockets: /run/twind\nstate_dir: /var/lib/twind\n"
    "thresholds:\n  latency_warn_ms: 20.0\n  latency_block_ms: 80.0\nlog_level: info\ngap: false\ncpu: 1\n",
)
TEMPLATES = sorted(files("twind.learn.cards").joinpath("templates").iterdir(), key=lambda each: each.name)
CARDS = (HEAD + PLAIN, HEAD + COUNTER, STANDING + STANDING_LSTM, *(each.read_text() for each in TEMPLATES))


class YamlTexts(FuzzTarget):
    """A reader of YAML that is given changed texts."""

    def __init__(self, texts: Sequence[str], read: Callable[[bytes], object]) -> None:
        self._texts = texts
        self._read = read
        self.accepted = 0

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        data = mutated_yaml(rng, rng.choice(self._texts))
        self.accepted += is_accepted(lambda: self._read(data), len(data))

    def finish(self) -> str:
        """Number of accepted inputs."""
        return f"{self.accepted} accepted"


class Settings(YamlTexts):
    """Files of the daemon's settings."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="twind-fuzz-")
        super().__init__(SETTINGS, self._load)

    def _load(self, data: bytes) -> None:
        path = Path(self._folder.name, "twind.yaml")
        path.write_bytes(data)
        settings = load_settings(path, {}, 1000)
        settings.parameters()
        settings.calibration_path("h24")

    def close(self) -> None:
        """Remove the folder."""
        self._folder.cleanup()


class Cards(YamlTexts):
    """Cards of policies."""

    def __init__(self) -> None:
        super().__init__(CARDS, lambda data: parse_card(data.decode("utf-8", "surrogateescape"), "card"))
