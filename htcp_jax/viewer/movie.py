"""Writing of movies as GIF, or as MP4 with the extra `movie`.

A `Film` draws each frame on demand, so its memory does not depend on its length.
"""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from htcp_jax.errors import InputError, install_command

RATE = 20  # frames per second
LAST_REPEATS = 20  # number of repetitions of the last frame
COLOURS, PALETTE_FRAMES = 128, 16  # number of colours in a GIF's palette, and of frames from which it is computed
KINDS = "gif", "mp4"

Frame = UInt8[np.ndarray, "H W 3"]


class Film:
    """Sequence of frames, each drawn on demand.

    Args:
        count: The number of frames.
        draw: Function that returns the k-th frame.
        last_repeats: How many more times the last frame is shown.
    """

    def __init__(self, count: int, draw: Callable[[int], Frame], last_repeats: int = LAST_REPEATS):
        self._count, self._draw, self.last_repeats = count, draw, last_repeats

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k: int) -> Frame:
        if not 0 <= k < self._count:
            raise IndexError(f"no frame {k}; valid: 0 to {self._count - 1}")
        return self._draw(k)

    def over(self, strip: Callable[[int], Frame]) -> "Film":
        """Return a film with the picture `strip(k)` below the k-th frame; both must have the same width."""
        return Film(self._count, lambda k: np.concatenate([self[k], strip(k)]), self.last_repeats)


def check_kind(kind: str) -> None:
    """Check that movies of this kind (`gif` or `mp4`) can be written.

    Raises:
        InputError: If the kind is unknown, or if the encoder for MP4 is missing.
    """
    if kind not in KINDS:
        raise InputError(f"{kind!r} is not a kind of movie; valid: {', '.join(KINDS)}")
    if kind == "mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            need = f"an MP4 needs imageio-ffmpeg: {install_command('movie')}"
            raise InputError(f"{need}; or choose gif") from None


def write_movie(file: Path, film: Film, reported: Callable[[int, int], None] = lambda done, count: None) -> None:
    """Write a film as a GIF or an MP4.

    Args:
        file: The file; its suffix determines the format.
        film: The film; width and height of an MP4's frames must be even.
        reported: Function that is called after each frame with the number of written frames and of all frames.
    """
    (_write_gif if file.suffix.lower() == ".gif" else _write_mp4)(file, film, _one_by_one(film, reported))


def _one_by_one(film: Film, reported: Callable[[int, int], None]) -> Iterator[Frame]:
    for done, frame in enumerate(film, 1):
        yield frame
        reported(done, len(film))


def _write_gif(file: Path, film: Film, frames: Iterator[Frame]) -> None:
    """Write a GIF whose frames share one palette, so that objects at rest do not flicker.

    The palette is computed from PALETTE_FRAMES frames, because the tool hides marks in single frames. It is an octree:
    a median cut would lose the colours of small marks.
    """
    few = np.unique(np.linspace(0, len(film) - 1, PALETTE_FRAMES).round().astype(int))
    mosaic = Image.fromarray(np.concatenate([film[k] for k in few.tolist()]))
    palette = mosaic.quantize(COLOURS, method=Image.Quantize.FASTOCTREE)
    images = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    lasts = [1000 // RATE] * (len(film) - 1) + [max(film.last_repeats, 1) * 1000 // RATE]
    next(images).save(file, save_all=True, append_images=images, duration=lasts, loop=0, optimize=False)


def _write_mp4(file: Path, film: Film, frames: Iterator[Frame]) -> None:
    """Write an MP4 with the ffmpeg that imageio-ffmpeg contains.

    `subprocess` starts ffmpeg, because imageio-ffmpeg would fork, which is unsafe with JAX's threads.
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
