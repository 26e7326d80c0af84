"""Frames and slcan text of a CAN bus: every family's decoders, and the reader in its cycle."""

import re
from collections import Counter
from dataclasses import fields
from random import Random

import numpy as np

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.mangle import mangled, pieces
from tests.support.can_codec_frames import decode_all, noise_of, ranges
from tests.support.can_driver_rig import CanRig
from twind_drivers.can.codec_factory import make
from twind_drivers.ports.frame import EXTENDED, FRAME, NOTHING, REMOTE, Frames
from twind_drivers.ports.slcan_codec import PATIENCE, SlcanDecoder, encode
from twind_drivers.virtual.can.can_message import CanMessage

MODELS = {"damiao": "DM4310", "cubemars": "AK70-10", "robstride": "RS01", "odrive": "ODrive"}
LINE = re.compile(rb"([tr][0-7][0-9a-fA-F]{2}|[TR][01][0-9a-fA-F]{7})([0-8])((?:[0-9a-fA-F]{2})*)")
CYCLE = ("DM4310", "RS01", "ODrive", "AK70-10")
AGED = 400  # inputs after which the bus of the reader is a new one


def frames_of(text: bytes) -> Frames:
    """The frames of all lines that have ended: the slow way."""
    rows = []
    for line, end in re.findall(rb"([^\r\a]*)([\r\a])", text):
        found = LINE.fullmatch(line)
        remote = line[:1] in b"rR"
        if not found or end == b"\a" or len(found[3]) != (0 if remote else 2 * int(found[2])):
            continue
        id = int(found[1][1:], 16) | (EXTENDED if line[:1] in b"TR" else 0) | (REMOTE if remote else 0)
        rows.append((id, int(found[2]), bytes(3), list(bytes.fromhex(found[3].decode()).ljust(8, b"\0"))))
    return np.array(rows, FRAME) if rows else NOTHING


class Can(FuzzTarget):
    """Decoders of the families, of slcan, and the reader of a bus with all families. An input is a frame."""

    def __init__(self) -> None:
        self._rig: CanRig | None = None
        self._age = 0
        self._counts: Counter[str] = Counter()

    def one(self, rng: Random) -> int:
        """A batch of frames to one of them; how many. Raises whatever is wrong."""
        kind = rng.randrange(10)
        with np.errstate(all="raise"):
            if kind < 2:
                name = rng.choice(list(MODELS))
                count = _decoders(rng, name)
            elif kind < 9:
                name = "slcan"
                count = _text(rng)
            else:
                name = "reader"
                count = self._cycle(rng)
        self._counts[name] += count
        return count

    def finish(self) -> str:
        """Number of frames by decoder."""
        return ", ".join(f"{name} {count} frames" for name, count in sorted(self._counts.items()))

    def _cycle(self, rng: Random) -> int:
        """Any frames among those of a cycle: nothing raises, and a silent actuator reads zero."""
        if self._rig is None or self._age > AGED:
            self._rig = CanRig(CYCLE)
            self._rig.positions()
            self._age = 0
        self._age += 1
        rig = self._rig
        claims = [id for family, _ in rig.reader.fleet.families for id in sorted(family.claims)]
        frames = noise_of(np.random.default_rng(rng.randrange(1 << 32)), claims, 20)
        for frame in frames:
            id = int(frame["id"]) & ~0x6000_0000  # a wire has no error frames
            message = CanMessage(id, bytes(frame["data"][: min(8, int(frame["size"]))]))
            rig.bus.controller.receive_frame(message, rig.clock.now())
        sample = rig.tick()
        assert sample.position.dtype.kind == "i" and not sample.position[~sample.heard].any()
        return len(frames)


def _decoders(rng: Random, name: str) -> int:
    """Any frames to the decoders of one family, which judge each by itself."""
    ids = rng.sample(range(1, 16), rng.choice((1, 3, 8)))
    family = make(name, "can0", ids, [MODELS[name]] * len(ids), ranges=ranges(len(ids)))
    near = sorted(family.claims) or [1]
    most = rng.choice((80, 80, 80, 10_000))
    frames = noise_of(np.random.default_rng(rng.randrange(1 << 32)), near, most)
    decode_all(family, frames)
    batch, told = family.feedback(frames)
    places = np.flatnonzero(told).tolist()
    others = range(len(frames))
    for place in rng.sample(places, min(3, len(places))) + rng.sample(others, min(1, len(others))):
        alone, told_alone = family.feedback(frames[place : place + 1])
        assert told_alone[0] == told[place]
        if told[place]:
            row = int(told[:place].sum())
            for field in fields(batch):
                together = getattr(batch, field.name)[row : row + 1]
                assert np.array_equal(getattr(alone, field.name), together, equal_nan=True), field.name
    return len(frames)


def _text(rng: Random) -> int:
    """Lines of slcan in any pieces: the frames of the slow way, in their order, and little kept."""
    made = noise_of(np.random.default_rng(rng.randrange(1 << 32)), [0x11, 0x7FF], rng.choice((1, 4, 80, 160)))
    made["size"] %= 9
    extended = made["id"] & EXTENDED != 0
    made["id"] &= np.where(extended, 0xDFFF_FFFF, 0x4000_07FF).astype(np.uint32)
    text = encode(made)
    if rng.random() < 0.8:
        text = mangled(rng, text, rng.randrange(1, 5))
        for _ in range(rng.randrange(3)):
            at = rng.randrange(len(text) + 1)
            text = text[:at] + rng.choice((b"\r", b"\a", b"z\r", b"F80\r", b"V1013\r", b"t" * 70)) + text[at:]
    decoder = SlcanDecoder()
    found = []
    for piece in pieces(rng, text):
        found.append(decoder.take(piece))
        assert decoder.pending_size <= PATIENCE
    assert (np.concatenate([*found, NOTHING]) == frames_of(text)).all()
    return len(made)
