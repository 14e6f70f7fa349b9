"""Machine code on disk, shared by processes that start together."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from conftest import at_night
from cornercase._common import compiling
from cornercase._common.compiling import count_kernels, heard_compilation, kernel, why_not_kept
from cornercase._common.kernel_contents import contents

PROGRAM = """
import json, sys, time
import numpy as np
from numba.core.caching import IndexDataCacheFile
from cornercase.dtw import distance_matrix

# The others read the index in between, and who writes it first writes its machine code last.
index, data = IndexDataCacheFile._save_index, IndexDataCacheFile._save_data
delay = float(sys.argv.pop(1))
IndexDataCacheFile._save_index = lambda *all: (time.sleep(0.5), index(*all))
IndexDataCacheFile._save_data = lambda *all: (time.sleep(delay), data(*all))

rng = np.random.default_rng(0)
series = [rng.normal(size=(9, 2)) for _ in range(4)]
found = {}
for name in sys.argv[1:]:
    cost, dims = name.split("-")
    found[name] = distance_matrix([one[:, : int(dims)] for one in series], local_cost=cost, n_jobs=1).tolist()
print(json.dumps(found))
"""
VERSIONS = ["euclidean-1", "squared-1", "euclidean-2", "squared-2"]


def started(folder, delay, *names):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(delay), *names], stdout=subprocess.PIPE, text=True, env=environment
    )


def said(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return json.loads(out)


@pytest.mark.parametrize("count", at_night([2, 4], {4}))
def test_processes_that_compile_at_once_do_not_mix_up_their_kernels(tmp_path, count):
    """Each begins with another version; then all of them are loaded from the disk, none is compiled."""
    folder, versions = tmp_path / "cache", VERSIONS[:count]
    processes = [started(folder, 0.4 * (count - 1 - k), *versions[k:], *versions[:k]) for k in range(count)]
    results = [said(process) for process in processes]
    before = sorted(path.name for path in folder.rglob("*.nbc"))
    later = said(started(folder, 0.0, *versions))
    assert sorted(path.name for path in folder.rglob("*.nbc")) == before
    assert len(before) == count
    for result in results:
        for name in versions:
            np.testing.assert_array_equal(result[name], later[name])
    flat, square = np.array(later["euclidean-1"]), np.array(later["squared-1"])
    assert (flat >= square - 1e-12).all()
    assert not np.allclose(flat, square)


@pytest.mark.parametrize("ending", at_night([".nbi", ".nbc"], {".nbi"}))
@pytest.mark.parametrize("left", at_night([0, 40], {0}))
def test_machine_code_that_was_cut_is_compiled_again(tmp_path, ending, left):
    first = said(started(tmp_path, 0.0, "euclidean-1"))
    for path in tmp_path.rglob(f"*{ending}"):
        path.write_bytes(path.read_bytes()[:left])
    assert said(started(tmp_path, 0.0, "euclidean-1")) == first
    whole = {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}
    assert said(started(tmp_path, 0.0, "euclidean-1")) == first
    assert whole == {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}


OUTER = """
import enum
import math
import numpy as np
import codes
from cornercase._common.compiling import kernel
from inner import inner
LIMIT = 5.0
@kernel({options})
def outer(x):
    {comment}
    if x > LIMIT:
        return codes.TABLE[codes.Code.FIRST]
    return inner(x)
print(outer(1.0), sum(outer.stats.cache_hits.values()))
"""


@pytest.mark.parametrize("kept_each_time", at_night([False, True], {True}))
def test_a_kernel_is_compiled_again_when_what_it_holds_has_changed(tmp_path, kept_each_time):
    """Whether it stands in its own module or in another one; and not when a comment has."""
    inner = "from cornercase._common.compiling import kernel\n@kernel()\ndef inner(x):\n    return later(x)\n"
    inner += "@kernel()\ndef later(x):\n    return x + 1\n"
    codes = "import enum\nimport numpy as np\nTABLE = np.array([1.0, 2.0])\nclass Code(enum.IntEnum):\n    FIRST = 0\n"
    files = {"inner.py": inner, "codes.py": codes, "outer.py": OUTER.format(options="", comment="#")}

    def printed():
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        # Python itself does not notice that a file has changed within a second to one of the same size.
        kept = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        environment = {**os.environ, **kept}
        command = [sys.executable, str(tmp_path / "outer.py")]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    def assert_compiled(value):
        assert printed() == [value, "0"]
        if kept_each_time:
            assert printed() == [value, "1"]

    assert_compiled("2.0")
    files["inner.py"] = inner.replace("x + 1", "x + 2")
    assert_compiled("3.0")
    files["outer.py"] = OUTER.format(options="", comment="# more\n    # of it")
    assert printed() == ["3.0", "1"]
    files["outer.py"] = files["outer.py"].replace("LIMIT = 5.0", "LIMIT = 0.5")
    assert_compiled("1.0")
    files["codes.py"] = codes.replace("1.0,", "4.0,")
    assert_compiled("4.0")
    files["codes.py"] = files["codes.py"].replace("FIRST = 0", "FIRST = 1")
    assert_compiled("2.0")
    files["outer.py"] = files["outer.py"].replace("@kernel()", "@kernel(fastmath=True)")
    assert_compiled("2.0")


def test_a_kernel_is_compiled_again_when_the_fields_of_a_named_tuple_have_changed_places(tmp_path):
    program = (
        "from typing import NamedTuple\nfrom cornercase._common.compiling import kernel\n"
        "class Place(NamedTuple):\n    {}: float\n    {}: float\n"
        "@kernel()\ndef read(place):\n    return place[0].x\n"
        "print(read((Place(x=1.0, y=2.0),)), sum(read.stats.cache_hits.values()))\n"
    )

    def printed(*names):
        (tmp_path / "reading.py").write_text(program.format(*names))
        # Both programs are as long and as old, to the second: Python takes its bytecode of one for the other's.
        unread = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        environment = {**os.environ, **unread}
        command = [sys.executable, "-c", "import reading"]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=tmp_path)
        return ran.stdout.split()

    assert [printed("x", "y"), printed("x", "y")] == [["1.0", "0"], ["1.0", "1"]]
    assert printed("y", "x") == ["1.0", "0"]


def test_a_global_without_a_digest_is_refused():
    function = FunctionType(compile("limits", "", "eval"), {"limits": [1.0], "__name__": __name__})
    with pytest.raises(TypeError, match="no digest"):
        contents(function, {})


def test_who_listens_hears_what_is_compiled_and_the_user_does_not(caplog):
    def double(x):
        return 2 * x

    doubled: Any = kernel()(double)
    ready, known = count_kernels()
    heard: list[str] = []
    with heard_compilation(heard.append):
        doubled._cache.flush()
        assert doubled(2) == 4
        assert doubled(3) == 6
    assert heard == [f"{__name__}.double"]
    assert count_kernels() == (ready + 1, known)
    assert caplog.records == []


def test_a_full_disk_keeps_nobody_from_what_is_compiled(caplog, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def triple(x):
        return 3 * x

    tripled: Any = kernel()(triple)
    tripled._cache.flush()
    monkeypatch.setattr("numba.core.caching.FunctionCache.save_overload", refuse)
    monkeypatch.setattr(compiling._WATCH, "unkept", "")
    assert tripled(2) == 6
    assert "No space left on device" in why_not_kept()
    assert "What is compiled cannot be kept" in caplog.text


COMPANION = """
from cornercase._common.compiling import companion, kernel
@kernel()
def one(x):
    return x + 1
@kernel()
def two(x):
    return x + 2
started = []
with companion(lambda: started.append(1)):
    one(1), two(1)
two(1.0)
print(len(started))
"""


def test_a_companion_is_started_once_and_only_where_something_is_compiled(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(COMPANION)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = [
        subprocess.run([sys.executable, program], env=environment, check=True, capture_output=True, text=True).stdout
        for _ in range(2)
    ]
    assert said == ["1\n", "0\n"]
