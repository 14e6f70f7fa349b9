"""Arrays as bytes: what NumPy and other programs pack is read, in whatever way the archive lists it."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.study import _codec as codec

ARRAYS = {"time": np.arange(40) / 20.0, "x": np.ones((3, 40)), "names": np.array(["Ego", "Fußgänger"])}


def zipped(**options):
    """The arrays as another program may pack them."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", options.get("method", zipfile.ZIP_DEFLATED)) as archive:
        archive.comment = options.get("comment", b"")
        for name, array in ARRAYS.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            member.extra, member.comment = options.get("extra", b""), options.get("member_comment", b"")
            content = io.BytesIO()
            np.save(content, array)
            archive.writestr(member, content.getvalue(), options.get("method", zipfile.ZIP_DEFLATED))
    return stream.getvalue()


def saved(save):
    stream = io.BytesIO()
    save(stream, **ARRAYS)
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        codec.pack_arrays(ARRAYS),
        saved(np.savez),
        saved(np.savez_compressed),
        zipped(method=zipfile.ZIP_STORED),
        zipped(comment=b"made elsewhere"),
        zipped(extra=b"\x99\x99\x02\x00ab"),
        zipped(member_comment=b"the way"),
    ],
    ids=["own", "savez", "compressed", "stored", "comment", "extra", "of a member"],
)
def test_whoever_packs_arrays_they_come_back(data):
    found = codec.unpack_arrays(data)
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


def test_damage_is_told_the_same_however_the_list_is_read(monkeypatch):
    whole, rng = codec.pack_arrays(ARRAYS), np.random.default_rng(5)
    begin = whole.index(b"PK\x01\x02")
    damaged = [whole[:-k] for k in (1, 22, 40)]
    for place in rng.integers(begin, len(whole), 300).tolist():
        other = bytearray(whole)
        other[place] ^= int(rng.integers(1, 256))
        damaged.append(bytes(other))

    def read() -> list[dict[str, bytes] | None]:
        found: list[dict[str, bytes] | None] = []
        for one in damaged:
            try:
                found.append({name: array.tobytes() for name, array in codec.unpack_arrays(one).items()})
            except InputError:
                found.append(None)
        return found

    quick = read()
    monkeypatch.setattr(codec, "_parse_zip_directory", lambda *_: None)
    assert quick == read()
    assert quick.count(None) > 100
