"""Writers of replay films as GIF and MP4 files."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from PIL import Image

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.platform import find_program

if TYPE_CHECKING:
    from cornercase.report.replays._frames import Frame

_N_COLOURS: Final = 255
# Seconds for which an MP4 shows its last frame.
_FINAL_PAUSE: Final = 1.5


def nearest_gif_rate(fps: float) -> float:
    """Return the possible GIF frame rate near `fps`, at most 50; GIF frames last whole hundredths of a second."""
    return 100.0 / max(2, round(100.0 / fps))


def write_gif(frames: Iterator[Frame], path: Path, fps: float) -> None:
    """Write frames, shape (height, width, 3), as a GIF; `fps` must be a rate that `nearest_gif_rate` returns.

    The same frames give the same bytes.
    """
    first = Image.fromarray(next(frames)).copy()
    # One palette for all frames, so that static parts keep their colour.
    palette = first.quantize(_N_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palettes = [palette]

    def quantize_frames() -> Iterator[Image.Image]:
        for frame in frames:
            yield Image.fromarray(frame).quantize(palette=palettes[0], dither=Image.Dither.NONE)

    frame_ms = round(1000.0 / fps)
    palette.save(
        path, format="GIF", save_all=True, append_images=quantize_frames(), duration=frame_ms, loop=0, optimize=False
    )


def find_ffmpeg() -> str:
    """Return the path of ffmpeg; InputError if it is not installed."""
    program = find_program("ffmpeg")
    if program is None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe

            program = str(get_ffmpeg_exe())
        except (ImportError, RuntimeError):
            raise InputError(
                "Writing an .mp4 needs ffmpeg, which is not on the PATH: install it, or use the extra 'video'"
                f" ({describe_install('video')}); .gif and .html do not need it."
            ) from None
    return program


def write_mp4(frames: Iterator[Frame], path: Path, fps: float) -> None:
    """Write frames, shape (height, width, 3), as an MP4 that all browsers play; InputError if ffmpeg fails.

    Height and width must be even.
    """
    program = find_ffmpeg()
    first = next(frames)
    height, width, _ = first.shape
    command = [
        program, "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-an", "-vf", f"tpad=stop_mode=clone:stop_duration={_FINAL_PAUSE}",
        "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart",
        "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1", "-f", "mp4", str(path.resolve()),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as error_file:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=error_file)
        assert process.stdin is not None
        try:
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
            process.stdin.flush()
        except BrokenPipeError:
            pass  # the error message is read below
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode != 0:
            error_file.seek(0)
            lines = error_file.read().decode(errors="replace").split("\n")
            raise InputError(f"ffmpeg could not write the film: {lines[0].strip() or process.returncode}.")
