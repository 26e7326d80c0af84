"""Decoding of videos that the program wrote."""

import re
import subprocess
from pathlib import Path

import numpy as np


def decoded(path: Path) -> tuple[list[np.ndarray], tuple[int, int], float]:
    """Pictures (h, w, 3), size (w, h) and pictures per second of an .mp4 file."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True, stdin=subprocess.DEVNULL)
    facts = re.search(rb"Video: h264.*? (\d{2,})x(\d{2,})[ ,].*? ([\d.]+) fps", done.stderr)
    assert facts is not None, done.stderr[-500:]
    wide = int(facts[1])
    high = int(facts[2])
    pictures = np.frombuffer(done.stdout, np.uint8).reshape(-1, high, wide, 3)
    return list(pictures), (wide, high), float(facts[3])
