"""Writing the replay of a scenario to a file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common import arguments
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.files import require_other_file, written_whole
from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray
from cornercase.report.replays.footage import Footage, read_footage
from cornercase.report.roads import is_of_map
from cornercase.scenario import Scenario
from cornercase.study import Study, open_study

if TYPE_CHECKING:
    from cornercase.report.replays.film import Frame

_ENDINGS: Final = (".html", ".gif", ".mp4")
_FASTEST: Final = 60.0
# A frame of a GIF lasts two hundredths of a second at least.
_FASTEST_GIF: Final = 50.0
# A GIF with more frames, or larger ones, is too large to be sent.
_RATES: Final = {".gif": 10.0, ".mp4": 25.0}
_DOTS: Final = {".gif": 75, ".mp4": 100}
_MOST_FRAMES: Final = 20_000


def replay(
    study: Study | Path | str,
    id: int,  # noqa: A002
    path: Path | str,
    *,
    beside: int | None = None,
    fps: float | None = None,
    speed: float = 1.0,
    scenario: Path | str | Scenario | None = None,
    critical: float | None = None,
    progress: bool = False,
) -> Path:
    """Write the replay of a scenario: who drives where on the road, and how critical that is.

    Parameters
    ----------
    study : Study or path
        In which the scenario was run.
    id : int
        Of the scenario.
    path : path
        A page where it ends with ``.html``, to play, scrub and zoom in any browser; else a film that stands for
        itself, ``.gif`` or ``.mp4``. The same study gives the same bytes, but for ``.mp4`` of another ffmpeg.
    beside : int, optional
        Another scenario, shown beside it on the same clock.
    fps : float, optional
        Frames for each second of a film, 60 at most; by default 25 of an MP4 and 10 of a GIF, of which a frame lasts
        whole hundredths of a second.
    speed : float, default 1
        How fast a film runs: 0.5 shows 1 s of the recording in 2 s.
    scenario : path or Scenario, optional
        The scenario file that was explored, for the road; by default it is looked for beside the study and in the
        current folder. Where it is not found, there is no road.
    critical : float, optional
        Another threshold than the study's own, which stays as it is.
    progress : bool, default False
        Show how far it is, on standard error.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    InputError
        A scenario is not there, failed or was not run yet; the ending is none of these; `fps` or `speed` is given for a
        page; there is no ffmpeg for an ``.mp4``; the `scenario` is not the one that was explored; or the file cannot be
        written.

    See Also
    --------
    cornercase.write_report : The page of the whole study, in which each scenario can be replayed.
    """
    path = arguments.path("path", path)
    ids = [arguments.whole_number("id", id, least=1)]
    if beside is not None:
        ids.append(arguments.whole_number("beside", beside, least=1))
    speed, ending = arguments.number("speed", speed, above=0.0), path.suffix.lower()
    rate = _RATES.get(ending, 0.0) if fps is None else arguments.number("fps", fps, above=0.0)
    if rate > _FASTEST:
        raise InputError(f"`fps` {rate:g}: give at most {_FASTEST:g}.")
    if ending == ".gif" and rate > _FASTEST_GIF:
        raise InputError(f"`fps` {rate:g}: a GIF shows at most {_FASTEST_GIF:g}; write an .mp4.")
    if ending not in _ENDINGS:
        raise InputError(f"`path` {path}: ends with none of {', '.join(_ENDINGS)}, which say what is written.")
    if ending == ".html" and (fps is not None or speed != 1.0):
        raise InputError("`fps` and `speed` are for films, and a page has its own controls; leave them out.")
    if ending == ".mp4":
        from cornercase.report.replays.encoding import find_ffmpeg

        find_ffmpeg()
    with open_study(study, readonly=True, critical=critical) as opened:
        require_other_file(path, opened.path)
        footage = read_footage(opened, ids, scenario)
    if footage.road_missing and (ending != ".html" or is_of_map(footage.road_missing)):
        # The page says it by itself; what an option mends is said at once.
        warnings.warn(footage.road_missing.removesuffix("."), NoticeWarning, stacklevel=2)
    with written_whole(path) as temporary:
        if ending == ".html":
            from cornercase.report.replays.page import fill_replay

            temporary.write_text(fill_replay(footage), encoding="utf-8", errors="backslashreplace", newline="\n")
        else:
            _write_film(footage, temporary, ending, rate, speed, progress)
    return path


def _write_film(footage: Footage, path: Path, ending: str, fps: float, speed: float, progress: bool) -> None:
    from cornercase.report.figures.style import default_style
    from cornercase.report.replays.encoding import gif_rate, write_gif, write_mp4
    from cornercase.report.replays.film import Film

    rate = gif_rate(fps) if ending == ".gif" else fps
    times = _times(footage, speed / rate)
    bar = ProgressBar(len(times), "drawing", "frames") if progress else None
    try:
        with default_style():
            frames = _counted(Film(footage, dots=_DOTS[ending]).frames(times), bar)
            (write_gif if ending == ".gif" else write_mp4)(frames, path, rate)
    finally:
        if bar is not None:
            bar.stop()


def _times(footage: Footage, step: float) -> FloatArray:
    """Times of frames from the begin to the end, which is one of them."""
    span = footage.end - footage.begin
    if span / step > _MOST_FRAMES:
        raise InputError(
            f"The film would have {span / step:.0f} frames, more than {_MOST_FRAMES}; give a higher `speed`, or a lower"
            " `fps`."
        )
    times = footage.begin + step * np.arange(np.floor(span / step + 1e-9) + 1)
    return np.append(times, footage.end) if footage.end - times[-1] > 1e-6 else times


def _counted(frames: Iterator[Frame], bar: ProgressBar | None) -> Iterator[Frame]:
    for k, frame in enumerate(frames, 1):
        yield frame
        if bar is not None:
            bar.update(k, "")
