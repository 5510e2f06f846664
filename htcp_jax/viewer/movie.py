"""Writing of movies: a GIF, which needs no extra, or an MP4, which needs the extra `movie`.

A film draws each frame on request, so that a long one needs no memory.
"""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from htcp_jax.errors import InputError

RATE = 20  # frames a second
LAST_REPEATS = 20  # number of repetitions of the last frame
COLOURS, PALETTE_FRAMES = 128, 16  # palette of a GIF, and number of frames that it is computed from
KINDS = "gif", "mp4"

Frame = UInt8[np.ndarray, "H W 3"]


class Film:
    """A sequence of frames, each drawn on request.

    Args:
        count: The number of frames.
        draw: Draws the k-th frame.
        last_repeats: The number of repetitions of the last frame.
    """

    def __init__(self, count: int, draw: Callable[[int], Frame], last_repeats: int = LAST_REPEATS):
        self._count, self._draw, self.last_repeats = count, draw, last_repeats

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k: int) -> Frame:
        if not 0 <= k < self._count:
            raise IndexError(f"no frame {k}; there are {self._count}")
        return self._draw(k)

    def over(self, strip: Callable[[int], Frame]) -> "Film":
        """Return the film with `strip(k)`, which has the same width, below the k-th frame."""
        return Film(self._count, lambda k: np.concatenate([self[k], strip(k)]), self.last_repeats)


def check_kind(kind: str) -> None:
    """Check that movies of a kind can be written.

    Raises:
        InputError: For an unknown kind, and for an MP4 if its encoder is missing.
    """
    if kind not in KINDS:
        raise InputError(f"a movie is one of {', '.join(KINDS)}, not {kind!r}")
    if kind == "mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError("an MP4 needs imageio-ffmpeg: pip install 'htcp_jax[movie]'; a GIF does not") from None


def write_movie(file: Path, film: Film, reported: Callable[[int, int], None] = lambda done, count: None) -> None:
    """Write a film as a GIF or an MP4.

    Args:
        file: The file; its suffix is the format.
        film: The film; width and height of an MP4's frames must be even.
        reported: Called after each frame with the number of written frames and of all.
    """
    (_write_gif if file.suffix.lower() == ".gif" else _write_mp4)(file, film, _one_by_one(film, reported))


def _one_by_one(film: Film, reported: Callable[[int, int], None]) -> Iterator[Frame]:
    for done, frame in enumerate(film, 1):
        yield frame
        reported(done, len(film))


def _write_gif(file: Path, film: Film, frames: Iterator[Frame]) -> None:
    """Write a GIF whose frames share the palette of a few, so that fixed parts do not flicker.

    The last frame alone is not enough, as the tool may hide blue marks in it. An octree keeps the colours of small
    marks; a median cut would use them for the shades of the arm.
    """
    few = np.unique(np.linspace(0, len(film) - 1, PALETTE_FRAMES).round().astype(int))
    mosaic = Image.fromarray(np.concatenate([film[k] for k in few.tolist()]))
    palette = mosaic.quantize(COLOURS, method=Image.Quantize.FASTOCTREE)
    images = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    lasts = [1000 // RATE] * (len(film) - 1) + [max(film.last_repeats, 1) * 1000 // RATE]
    next(images).save(file, save_all=True, append_images=images, duration=lasts, loop=0, optimize=False)


def _write_mp4(file: Path, film: Film, frames: Iterator[Frame]) -> None:
    """Write an MP4 by imageio-ffmpeg's ffmpeg.

    It is started as a subprocess, as that package forks, which is unsafe with JAX's threads.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    height, width = film[0].shape[:2]
    raw = "-f rawvideo -pix_fmt rgb24".split()
    codec = "-c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart".split()
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *raw, "-s", f"{width}x{height}", "-r", str(RATE), "-i", "-"]
    with subprocess.Popen([*command, *codec, file], stdin=subprocess.PIPE, stderr=subprocess.PIPE) as ffmpeg:
        for frame in frames:
            ffmpeg.stdin.write(frame.tobytes())
        ffmpeg.stdin.write(film.last_repeats * frame.tobytes())
        _, errors = ffmpeg.communicate()
    if ffmpeg.returncode:
        raise OSError(ffmpeg.returncode, errors.decode(errors="replace").strip() or "ffmpeg failed")
