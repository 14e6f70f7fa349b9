"""Write the replay of a scenario to a file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write, check_output_differs_from_source
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray
from cornercase._common.unknown_names import suggest_arguments
from cornercase.report._road_drawing import is_missing_map
from cornercase.report.replays._replay_data import ReplayData, read_replay_data
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study

if TYPE_CHECKING:
    from cornercase.report.replays._frames import Frame

_FILE_ENDINGS: Final = (".html", ".gif", ".mp4")
_MAX_FPS: Final = 60.0
# A GIF frame lasts at least two hundredths of a second.
_MAX_GIF_FPS: Final = 50.0
# A GIF with more or larger frames would be too large to send.
_DEFAULT_FPS: Final = {".gif": 10.0, ".mp4": 25.0}
_DPI: Final = {".gif": 75, ".mp4": 100}
_MAX_FRAMES: Final = 20_000


@suggest_arguments
def replay(
    study: StudyFile | Path | str,
    id: int,  # noqa: A002
    path: Path | str,
    *,
    beside: int | None = None,
    fps: float | None = None,
    speed: float = 1.0,
    scenario: Path | str | ScenarioFile | None = None,
    critical: float | None = None,
    progress: bool = False,
) -> Path:
    """Write the replay of a scenario: the motion of all entities on the road, and its criticality over time.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study in which the scenario was run.
    id : int
        Id of the scenario.
    path : path
        ``.html`` for a page to play, scrub and zoom in any browser; ``.gif`` or ``.mp4`` for a film. The same study
        gives the same bytes (``.mp4``: with the same ffmpeg).
    beside : int, optional
        Id of another scenario, which is shown beside the first one at the same time of simulation.
    fps : float, optional
        Frames per second of a film: for MP4 at most 60, by default 25; for GIF at most 50, by default 10. Frames of a
        GIF last whole hundredths of a second.
    speed : float, default 1
        Speed of a film: 0.5 shows 1 s of the recording in 2 s.
    scenario : path or ScenarioFile, optional
        Scenario file that was explored, to draw the road. By default the file is searched where this machine explored
        it, then beside the study and in the current folder. Without the file, no road is drawn.
    critical : float, optional
        Score from which this replay shows a scenario as critical; by default the threshold of the study.
    progress : bool, default False
        Show a progress bar on standard error.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        A scenario does not exist, failed or was not run yet; the file ending is unknown; `fps` or `speed` is given for
        a page; ffmpeg is missing for an ``.mp4``; `scenario` is not the explored one; or the file cannot be written.

    See Also
    --------
    cornercase.write_report : The page of the whole study, in which each scenario can be replayed.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.replay("study.db", 45, "run.html", beside=3)  # doctest: +SKIP
    PosixPath('run.html')
    """
    path = validation.check_path("path", path)
    ids = [validation.check_int("id", id, minimum=1)]
    if beside is not None:
        ids.append(validation.check_int("beside", beside, minimum=1))
    speed, ending = validation.check_float("speed", speed, above=0.0), path.suffix.lower()
    rate = _DEFAULT_FPS.get(ending, 0.0) if fps is None else validation.check_float("fps", fps, above=0.0)
    if rate > _MAX_FPS:
        raise InputError(f"`fps` {rate:g}: give at most {_MAX_FPS:g}.")
    if ending == ".gif" and rate > _MAX_GIF_FPS:
        raise InputError(f"`fps` {rate:g}: a GIF shows at most {_MAX_GIF_FPS:g}; write an .mp4.")
    if ending not in _FILE_ENDINGS:
        raise InputError(f"`path` {path}: the file name must end with one of {', '.join(_FILE_ENDINGS)}.")
    if ending == ".html" and (fps is not None or speed != 1.0):
        raise InputError("`fps` and `speed` only apply to films; leave them out for a page.")
    if ending == ".mp4":
        from cornercase.report.replays._film_files import find_ffmpeg

        find_ffmpeg()
    with open_study(study, readonly=True, critical=critical) as opened:
        check_output_differs_from_source(path, opened.path)
        data = read_replay_data(opened, ids, scenario)
    if data.road_missing_reason and (ending != ".html" or is_missing_map(data.road_missing_reason)):
        # The page itself explains a missing road; a missing map can be fixed with an option, so warn at once.
        issue_notice_warning(data.road_missing_reason.removesuffix("."))
    with atomic_write(path) as temporary:
        if ending == ".html":
            from cornercase.report.replays._replay_page import render_replay_page

            temporary.write_text(render_replay_page(data), encoding="utf-8", errors="backslashreplace", newline="\n")
        else:
            _write_film(data, temporary, ending, rate, speed, progress)
    return path


def _write_film(data: ReplayData, path: Path, ending: str, fps: float, speed: float, progress: bool) -> None:
    from cornercase.report.figures._style import matplotlib_defaults
    from cornercase.report.replays._film_files import nearest_gif_rate, write_gif, write_mp4
    from cornercase.report.replays._frames import FrameRenderer

    rate = nearest_gif_rate(fps) if ending == ".gif" else fps
    times = _frame_times(data, speed / rate)
    bar = ProgressBar(len(times), "drawing", "frames") if progress else None
    try:
        with matplotlib_defaults():
            frames = _report_progress(FrameRenderer(data, dpi=_DPI[ending]).render_frames(times), bar)
            (write_gif if ending == ".gif" else write_mp4)(frames, path, rate)
    finally:
        if bar is not None:
            bar.stop()


def _frame_times(data: ReplayData, step: float) -> FloatArray:
    """Return the times of frames in s, from the start to the end of the replay, both included."""
    span = data.end_time - data.start_time
    if span / step > _MAX_FRAMES:
        raise InputError(
            f"The film would have {span / step:.0f} frames, more than {_MAX_FRAMES}; give a higher `speed`, or a lower"
            " `fps`."
        )
    times = data.start_time + step * np.arange(np.floor(span / step + 1e-9) + 1)
    return np.append(times, data.end_time) if data.end_time - times[-1] > 1e-6 else times


def _report_progress(frames: Iterator[Frame], bar: ProgressBar | None) -> Iterator[Frame]:
    for k, frame in enumerate(frames, 1):
        yield frame
        if bar is not None:
            bar.update(k, "")
