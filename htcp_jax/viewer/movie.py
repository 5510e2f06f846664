"""Frames to files: a GIF, which needs nothing more, or an MP4, which needs the extra `movie`."""

import subprocess
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from htcp_jax.errors import InputError

RATE = 20  # frames a second
HELD = 20  # times that the last frame is shown
COLOURS, PALETTE_FRAMES = 128, 16  # of a GIF, and how many of its frames they are taken from
KINDS = "gif", "mp4"

Frame = UInt8[np.ndarray, "H W 3"]


def check_kind(kind: str) -> None:
    """Raise InputError for an unknown kind, and for an MP4 where its encoder is missing."""
    if kind not in KINDS:
        raise InputError(f"a movie is one of {', '.join(KINDS)}, not {kind!r}")
    if kind == "mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError("an MP4 needs imageio-ffmpeg: pip install 'htcp_jax[movie]'; a GIF does not") from None


def write_movie(file: Path, frames: Iterator[Frame]) -> None:
    """Write the frames, the kind by the ending of the name; both sides of an MP4's frames are even."""
    (_write_gif if file.suffix == ".gif" else _write_mp4)(file, frames)


def _write_gif(file: Path, frames: Iterator[Frame]) -> None:
    """All frames share the colours of a few, so that what stands still does not flicker. The last alone would not do:
    in it the tool may hide what is blue before. An octree keeps the colours of small marks; a median cut would spend
    them on the shades of the arm."""
    frames = list(frames)
    images = [Image.fromarray(frame) for frame in frames]
    few = np.linspace(0, len(frames) - 1, PALETTE_FRAMES).round().astype(int)
    mosaic = Image.fromarray(np.concatenate([frames[k] for k in few]))
    palette = mosaic.quantize(COLOURS, method=Image.Quantize.FASTOCTREE)
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    lasts = [1000 // RATE] * len(others) + [HELD * 1000 // RATE]
    first.save(file, save_all=True, append_images=others, duration=lasts, loop=0, optimize=False)


def _write_mp4(file: Path, frames: Iterator[Frame]) -> None:
    """By the ffmpeg that imageio-ffmpeg brings; called without that package's fork, which JAX's threads forbid."""
    from imageio_ffmpeg import get_ffmpeg_exe

    first = next(frames)
    height, width = first.shape[:2]
    raw = "-f rawvideo -pix_fmt rgb24".split()
    film = "-c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart".split()
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *raw, "-s", f"{width}x{height}", "-r", str(RATE), "-i", "-"]
    with subprocess.Popen([*command, *film, file], stdin=subprocess.PIPE, stderr=subprocess.PIPE) as ffmpeg:
        for frame in chain([first], frames):
            ffmpeg.stdin.write(frame.tobytes())
        ffmpeg.stdin.write(HELD * frame.tobytes())
        _, said = ffmpeg.communicate()
    if ffmpeg.returncode:
        raise OSError(ffmpeg.returncode, said.decode(errors="replace").strip() or "ffmpeg failed")
