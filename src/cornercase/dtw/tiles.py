"""Distances computed by the workers of a Dask cluster, square by square."""

from __future__ import annotations

import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.dask_client import disconnected, ended, name_cluster, take, workers_of
from cornercase._common.errors import InputError
from cornercase._common.platform import available_cpus
from cornercase._common.version import __version__
from cornercase.dtw import pairs
from cornercase.dtw.pairs import Floats, Settings

if TYPE_CHECKING:
    from distributed import Client, Future

# Squares submitted per thread: enough that no thread waits, and few to store.
_AHEAD: Final = 2

# Retries of a square whose workers were lost.
_MOST_LOST: Final = 5

# Minimum and maximum number of series per side of a square in memory, and the preferred number of bands.
_SIDES: Final = (64, 1024)
_BANDS: Final = 12


class Tiles:
    """Squares of a distance matrix, computed by a cluster; identical to `pairs.distances` to the last bit.

    The series are sent once, in bands; a square needs two of them.
    """

    def __init__(self, client: Client, settings: Settings, bands: Sequence[Sequence[Floats]]) -> None:
        self._client, self._settings, self._bands = client, settings, bands
        self._sent: dict[int, Future[Any]] = {}

    def squares(self, wanted: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, Floats]]:
        """Yield (rows, columns, distances) for squares given by the indices of their bands, in the order of completion.

        Raises `InputError` if the workers cannot compute them, or the cluster is lost.
        """
        from distributed.scheduler import KilledWorker

        waiting = deque(wanted)
        lost: list[tuple[int, int]] = []
        running: dict[Future[Any], tuple[int, int]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < _AHEAD * self._threads():
                    square = waiting.popleft()
                    running[self._submit(*square)] = square
                for future in ended(self._client, list(running)):
                    square = running.pop(future)
                    result, error = take(self._client, future)
                    if error is None:
                        yield *square, result
                    elif isinstance(error, KilledWorker) and lost.count(square) < _MOST_LOST:
                        lost.append(square)
                        waiting.append(square)
                    else:
                        raise self._refused(error) from error
        except (OSError, CancelledError) as error:
            raise disconnected(self._client) from error
        finally:
            if self._client.status == "running":
                self._client.cancel([*running, *self._sent.values()])

    def _threads(self) -> int:
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def _submit(self, rows: int, columns: int) -> Future[Any]:
        machines: dict[str, int] = {}
        for worker in workers_of(self._client):
            machines[worker["host"]] = machines.get(worker["host"], 0) + worker["nthreads"]
        return self._client.submit(
            compute_square,
            __version__,
            self._settings,
            machines,
            self._band(rows),
            None if rows == columns else self._band(columns),
            key=f"cornercase-square-{uuid.uuid4().hex}",
            pure=False,
        )

    def _band(self, number: int) -> Future[Any]:
        if number not in self._sent or self._sent[number].status not in ("pending", "finished", "lost"):
            with warnings.catch_warnings():
                # The size is intended; as its own task a band is sent again if its worker is lost.
                warnings.filterwarnings("ignore", message="Sending large graph")
                self._sent[number] = self._client.submit(
                    _itself, self._bands[number], key=f"cornercase-band-{uuid.uuid4().hex}", pure=False
                )
        return self._sent[number]

    def _refused(self, error: Exception) -> InputError:
        if isinstance(error, InputError):
            return error
        words = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return InputError(
            f"`client` {name_cluster(self._client)}: its workers cannot compute distances ({words}); install the same"
            " package versions there as here, and run the same call again to resume."
        )


def _itself(band: Sequence[Floats]) -> Sequence[Floats]:
    return band


def compute_square(
    version: str,
    settings: Settings,
    machines: dict[str, int],
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
) -> Floats:
    """Compute a square of distances on a worker.

    Raises `InputError` if the worker has another `version` of cornercase. `machines`: number of threads of all workers
    of each machine, by address.
    """
    if version != __version__:
        raise InputError(
            f"`client`: a worker has cornercase {__version__}, but this process has {version}; install the same"
            " version everywhere."
        )
    from distributed import get_worker

    host = get_worker().address.rpartition("://")[2].rpartition(":")[0].strip("[]")
    # The threads of a machine share its cores.
    threads = max(1, available_cpus() // max(1, machines.get(host, 1)))
    return pairs.distances(rows, columns, replace(settings, n_jobs=threads), _unseen)


def _unseen(done: int) -> None:
    del done


def distances(
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
    settings: Settings,
    client: Client,
    advance: Callable[[int], None],
) -> Floats:
    """Compute distances of checked series on a cluster, like `pairs.distances`."""
    row_bands = bands_of(len(rows))
    parts: list[Sequence[Floats]] = [[rows[i] for i in band] for band in row_bands]
    if columns is None:
        result = np.zeros((len(rows), len(rows)), dtype=settings.dtype)
        squares = [(a, b) for a in range(len(parts)) for b in range(a, len(parts))]
    else:
        result = np.zeros((len(rows), len(columns)), dtype=settings.dtype)
        squares = [(a, len(row_bands)) for a in range(len(row_bands))]
        parts.append(columns)
    for a, b, square in Tiles(client, settings, parts).squares(squares):
        i = slice(row_bands[a].start, row_bands[a].stop)
        if columns is None:
            j = slice(row_bands[b].start, row_bands[b].stop)
            result[i, j], result[j, i] = square, square.T
        else:
            result[i] = square
        advance(pairs.cells(parts[a], None if a == b else parts[b]))
    return result


def bands_of(size: int) -> list[range]:
    """Split series into bands, so that squares are numerous but not too small."""
    side = min(max(-(-size // _BANDS), _SIDES[0]), _SIDES[1])
    return [range(first, min(first + side, size)) for first in range(0, size, side)]
