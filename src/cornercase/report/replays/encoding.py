"""Films as files."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from PIL import Image

from cornercase._common.errors import InputError
from cornercase._common.platform import find_program

if TYPE_CHECKING:
    from cornercase.report.replays.film import Frame

_COLOURS: Final = 255
# How long a film stands still at its end before it begins again, in s.
_REST: Final = 1.5

Encoder = Callable[[Iterator["Frame"], Path, float], None]
"""Writes frames to a path, so many for each second."""


def gif_rate(fps: float) -> float:
    """Find the nearest rate of frames that a GIF can have: a frame lasts whole hundredths of a second.

    Parameters
    ----------
    fps : float
        Frames for each second.

    Returns
    -------
    float
        50 at most.
    """
    return 100.0 / max(2, round(100.0 / fps))


def write_gif(frames: Iterator[Frame], path: Path, fps: float) -> None:
    """Write a GIF; the same frames give the same bytes.

    Parameters
    ----------
    frames : iterator of ndarray of uint8, shape (height, width, 3)
        Of which the last one stays for a while.
    path : Path
        Of the file.
    fps : float
        As of `gif_rate`.
    """
    first = Image.fromarray(next(frames)).copy()
    # One palette for all frames: what does not move keeps its colour.
    palette = first.quantize(_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    waiting = [palette]

    def pictures() -> Iterator[Image.Image]:
        for frame in frames:
            yield Image.fromarray(frame).quantize(palette=waiting[0], dither=Image.Dither.NONE)

    each = round(1000.0 / fps)
    palette.save(path, format="GIF", save_all=True, append_images=pictures(), duration=each, loop=0, optimize=False)


def find_ffmpeg() -> str:
    """Find the program that writes films.

    Returns
    -------
    str
        Path of ffmpeg.

    Raises
    ------
    InputError
        There is none.
    """
    found = find_program("ffmpeg")
    if found is None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe

            found = str(get_ffmpeg_exe())
        except (ImportError, RuntimeError):
            raise InputError(
                "An .mp4 is written by ffmpeg, which is not on the PATH: install it, or `pip install"
                " 'cornercase[video]'`; .gif and .html need nothing more."
            ) from None
    return found


def write_mp4(frames: Iterator[Frame], path: Path, fps: float) -> None:
    """Write an MP4 that every browser and player shows.

    Parameters
    ----------
    frames : iterator of ndarray of uint8, shape (height, width, 3)
        With even width and height.
    path : Path
        Of the file.
    fps : float
        Frames for each second.

    Raises
    ------
    InputError
        There is no ffmpeg, or it fails.
    """
    program = find_ffmpeg()
    first = next(frames)
    height, width, _ = first.shape
    command = [
        program, "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-an", "-vf", f"tpad=stop_mode=clone:stop_duration={_REST}",
        "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart",
        "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1", "-f", "mp4", str(path.resolve()),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
        assert process.stdin is not None
        try:
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
            process.stdin.flush()
        except BrokenPipeError:
            # Why it ended is told below.
            pass
        except BaseException:
            process.kill()
            raise
        finally:
            # What could not be written is lost with it.
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode != 0:
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            raise InputError(f"ffmpeg could not write the film: {lines[0].strip() or process.returncode}.")
