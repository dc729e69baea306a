"""Pictures as a video: H.264 in an mp4, or an animated WebP that goes round, by the suffix of the file."""

import contextlib
import subprocess
import tempfile
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from multilight.datagen.errors import UserError
from multilight.scenes.arrays import UInt8

FPS = 24
CODECS = {
    ".mp4": ("libx264", "-crf", "18", "-movflags", "+faststart"),
    ".webp": ("libwebp_anim", "-quality", "80", "-loop", "0"),
}


def write_video(path: Path, frames: Iterable[UInt8]) -> float:
    """Write pictures (H, W, 3) of one size, height and width even, `FPS` a second; return how long they take [s].

    Raises `UserError`. ffmpeg is started by hand: `imageio_ffmpeg.write_frames` forks, which hangs where a library
    holds a lock.
    """
    rest = iter(frames)
    first = next(rest)
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{first.shape[1]}x{first.shape[0]}", "-r", str(FPS), "-i", "-"]
    coded = ["-c:v", *CODECS[path.suffix.lower()], "-pix_fmt", "yuv420p", str(path)]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *coded]
    count = 0
    with tempfile.TemporaryFile() as said:
        running = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said)
        with contextlib.suppress(BrokenPipeError), running:  # where ffmpeg ends early, it says why
            assert running.stdin is not None
            for count, picture in enumerate(chain([first], rest), start=1):  # noqa: B007
                running.stdin.write(np.ascontiguousarray(picture).data)
        if running.returncode:
            said.seek(0)
            reason = said.read().decode(errors="replace").strip().splitlines()
            raise UserError(f"video {path} cannot be written: {reason[-1] if reason else running.returncode}")
    return count / FPS
