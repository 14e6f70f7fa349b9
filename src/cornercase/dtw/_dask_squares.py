"""DTW distances computed by the workers of a Dask cluster, in squares (blocks of the distance matrix)."""

from __future__ import annotations

import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.platform import count_available_cpus
from cornercase._common.process.dask import (
    describe_cluster,
    pop_result,
    scheduler_gone_error,
    wait_for_any_task,
    wait_for_workers,
)
from cornercase._common.version import __version__
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw._in_memory import DtwSettings, Floats

if TYPE_CHECKING:
    from distributed import Client, Future

# Squares submitted per thread: enough that no thread waits, but few, since their results need memory.
_SQUARES_PER_THREAD: Final = 2

# Retries of a square whose workers were lost.
_MAX_RETRIES: Final = 5

# Minimum and maximum number of series per side of a square in memory, and the preferred number of bands.
_SIDE_RANGE: Final = (64, 1024)
_MIN_BANDS: Final = 12


class DaskSquares:
    """Squares (blocks) of a distance matrix, computed by a Dask cluster, with the same bits as on this machine.

    The series are divided into bands. Each band is sent to the Dask cluster once. A square needs two bands: for its
    rows and its columns.
    """

    def __init__(self, client: Client, settings: DtwSettings, bands: Sequence[Sequence[Floats]]) -> None:
        self._client, self._settings, self._bands = client, settings, bands
        self._band_futures: dict[int, Future[Any]] = {}

    def iter_squares(self, squares: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, Floats]]:
        """Yield (row band, column band, distances) for pairs of bands, in the order of completion.

        Raises `InputError` if the workers cannot compute distances, or the connection to the Dask cluster is lost.
        """
        from distributed.scheduler import KilledWorker

        waiting = deque(squares)
        lost: list[tuple[int, int]] = []
        running: dict[Future[Any], tuple[int, int]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < _SQUARES_PER_THREAD * self._n_threads():
                    square = waiting.popleft()
                    running[self._submit(*square)] = square
                for future in wait_for_any_task(self._client, list(running)):
                    square = running.pop(future)
                    result, error = pop_result(self._client, future)
                    if error is None:
                        yield *square, result
                    elif isinstance(error, KilledWorker) and lost.count(square) < _MAX_RETRIES:
                        lost.append(square)
                        waiting.append(square)
                    else:
                        raise self._worker_error(error) from error
        except (OSError, CancelledError) as error:
            raise scheduler_gone_error(self._client) from error
        finally:
            if self._client.status == "running":
                self._client.cancel([*running, *self._band_futures.values()])

    def _n_threads(self) -> int:
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def _submit(self, rows: int, columns: int) -> Future[Any]:
        machines: dict[str, int] = {}
        for worker in wait_for_workers(self._client):
            machines[worker["host"]] = machines.get(worker["host"], 0) + worker["nthreads"]
        return self._client.submit(
            compute_square_on_worker,
            __version__,
            self._settings,
            machines,
            self._send_band(rows),
            None if rows == columns else self._send_band(columns),
            key=f"cornercase-square-{uuid.uuid4().hex}",
            pure=False,
        )

    def _send_band(self, number: int) -> Future[Any]:
        if number not in self._band_futures or self._band_futures[number].status not in ("pending", "finished", "lost"):
            with warnings.catch_warnings():
                # The size is intended; as its own task a band is sent again if its worker is lost.
                warnings.filterwarnings("ignore", message="Sending large graph")
                self._band_futures[number] = self._client.submit(
                    _identity, self._bands[number], key=f"cornercase-band-{uuid.uuid4().hex}", pure=False
                )
        return self._band_futures[number]

    def _worker_error(self, error: Exception) -> InputError:
        if isinstance(error, InputError):
            return error
        words = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return InputError(
            f"`client` {describe_cluster(self._client)}: its workers cannot compute distances"
            f" ({words}); install the same"
            " package versions there as here, and run the same call again to resume."
        )


def _identity(band: Sequence[Floats]) -> Sequence[Floats]:
    return band


def compute_square_on_worker(
    version: str,
    settings: DtwSettings,
    machines: dict[str, int],
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
) -> Floats:
    """Compute a square (block) of distances on a worker.

    Raises `InputError` if the worker does not have the same `version` of cornercase. `machines` maps the address of
    each machine to the number of threads of all its workers.
    """
    if version != __version__:
        raise InputError(
            f"`client`: a worker has cornercase {__version__}, but this process has {version}; install the same"
            " version everywhere."
        )
    from distributed import get_worker

    host = get_worker().address.rpartition("://")[2].rpartition(":")[0].strip("[]")
    # The threads of a machine share its cores.
    threads = max(1, count_available_cpus() // max(1, machines.get(host, 1)))
    return pairs.compute_distances(rows, columns, replace(settings, n_jobs=threads), _ignore_progress)


def _ignore_progress(done: int) -> None:
    del done


def compute_distances_on_dask(
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
    settings: DtwSettings,
    client: Client,
    report_progress: Callable[[int], None],
) -> Floats:
    """Compute distances of validated series on a Dask cluster."""
    row_bands = split_into_bands(len(rows))
    parts: list[Sequence[Floats]] = [[rows[i] for i in band] for band in row_bands]
    if columns is None:
        result = np.zeros((len(rows), len(rows)), dtype=settings.dtype)
        squares = [(a, b) for a in range(len(parts)) for b in range(a, len(parts))]
    else:
        result = np.zeros((len(rows), len(columns)), dtype=settings.dtype)
        squares = [(a, len(row_bands)) for a in range(len(row_bands))]
        parts.append(columns)
    for a, b, square in DaskSquares(client, settings, parts).iter_squares(squares):
        i = slice(row_bands[a].start, row_bands[a].stop)
        if columns is None:
            j = slice(row_bands[b].start, row_bands[b].stop)
            result[i, j], result[j, i] = square, square.T
        else:
            result[i] = square
        report_progress(pairs.count_cells(parts[a], None if a == b else parts[b]))
    return result


def split_into_bands(size: int) -> list[range]:
    """Split `size` series into bands: ranges of indices.

    Each pair of bands is a square of the matrix. There should be enough squares for all workers, and a square should
    be large enough to be worth sending.
    """
    side = min(max(-(-size // _MIN_BANDS), _SIDE_RANGE[0]), _SIDE_RANGE[1])
    return [range(first, min(first + side, size)) for first in range(0, size, side)]
