"""Frames and slcan text of a CAN bus: every family's decoders, and the reader in its cycle."""

import re
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
    """Decoders of the families, of slcan, and the reader of a bus with all families."""

    def __init__(self) -> None:
        self._rig: CanRig | None = None
        self._age = 0

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        kind = rng.randrange(10)
        with np.errstate(all="raise"):
            if kind < 5:
                _decoders(rng)
            elif kind < 9:
                _text(rng)
            else:
                self._cycle(rng)

    def _cycle(self, rng: Random) -> None:
        """Any frames among those of a cycle: nothing raises, and a silent actuator reads zero."""
        if self._rig is None or self._age > AGED:
            self._rig = CanRig(CYCLE)
            self._rig.positions()
            self._age = 0
        self._age += 1
        rig = self._rig
        claims = [id for family, _ in rig.reader.fleet.families for id in sorted(family.claims)]
        for frame in noise_of(np.random.default_rng(rng.randrange(1 << 32)), claims)[:20]:
            id = int(frame["id"]) & ~0x6000_0000  # a wire has no error frames
            message = CanMessage(id, bytes(frame["data"][: min(8, int(frame["size"]))]))
            rig.bus.controller.receive_frame(message, rig.clock.now())
        sample = rig.tick()
        assert sample.position.dtype.kind == "i" and not sample.position[~sample.heard].any()


def _decoders(rng: Random) -> None:
    """Any frames to the decoders of one family."""
    name = rng.choice(list(MODELS))
    ids = rng.sample(range(1, 16), rng.choice((1, 3, 8)))
    family = make(name, "can0", ids, [MODELS[name]] * len(ids), ranges=ranges(len(ids)))
    near = sorted(family.claims) or [1]
    decode_all(family, noise_of(np.random.default_rng(rng.randrange(1 << 32)), near))


def _text(rng: Random) -> None:
    """Lines of slcan in any pieces: the frames of the slow way, in their order, and little kept."""
    made = noise_of(np.random.default_rng(rng.randrange(1 << 32)), [0x11, 0x7FF])[: rng.choice((1, 4, 24))]
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
