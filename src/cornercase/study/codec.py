"""Arrays and recordings as bytes, and back: NumPy's ``.npz``, so that any program can read them."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase.recordings import Collision, Recording

_ARRAYS: Final = ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")


def pack_arrays(arrays: Mapping[str, npt.ArrayLike]) -> bytes:
    """Make an archive of arrays; its bytes depend on them alone.

    Parameters
    ----------
    arrays : mapping of str to array_like

    Returns
    -------
    bytes
    """
    # np.savez stamps no time into its members.
    buffer = io.BytesIO()
    named: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    np.savez_compressed(buffer, **named)
    return buffer.getvalue()


def unpack_arrays(data: bytes) -> dict[str, npt.NDArray[Any]]:
    """Arrays of an archive, by name.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    InputError
        It is no such archive, or it holds something else than plain arrays.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as loaded:
            return {name: loaded[name] for name in loaded.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"The study holds arrays that cannot be read ({error}).") from error


def pack_recording(recording: Recording) -> bytes:
    """Make an archive of a recording.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    bytes
    """
    arrays: dict[str, npt.ArrayLike] = {name: getattr(recording, name) for name in _ARRAYS}
    arrays["names"], arrays["kinds"] = np.array(recording.names), np.array(recording.kinds)
    arrays["collision_time"] = np.array([c.time for c in recording.collisions], dtype=np.float64)
    arrays["collision_entities"] = np.array(
        [[recording.names.index(n) for n in c.entities] for c in recording.collisions], dtype=np.int64
    ).reshape(-1, 2)
    return pack_arrays(arrays)


def unpack_recording(data: bytes) -> Recording:
    """Recording of an archive.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        It is no such archive.
    """
    arrays = unpack_arrays(data)
    names = tuple(map(str, arrays["names"]))
    collisions = tuple(
        Collision(float(time), (names[a], names[b]))
        for time, (a, b) in zip(arrays["collision_time"], arrays["collision_entities"], strict=True)
    )
    return Recording(
        **{name: arrays[name] for name in _ARRAYS},
        names=names,
        kinds=tuple(map(str, arrays["kinds"])),
        collisions=collisions,
    )
