"""The kernel cache on disk, shared by processes that start at the same time."""

from __future__ import annotations

import errno
import gc
import json
import os
import subprocess
import sys
from types import FunctionType, ModuleType
from typing import Any

import pytest
from numba.core import event

from conftest import at_night
from cornercase._common.numba import kernel as kernel_module
from cornercase._common.numba.cache_key import kernel_digest
from cornercase._common.numba.kernel import count_ready_kernels, kernel, listen_to_compilation, reason_not_cached

PROGRAM = """
import json, sys, time
from numba.core.caching import IndexDataCacheFile
from cornercase._common.numba.kernel import kernel

# The others read the index in between; the first to write it is the last to write its machine code.
index, data = IndexDataCacheFile._save_index, IndexDataCacheFile._save_data
delay = float(sys.argv.pop(1))
IndexDataCacheFile._save_index = lambda *all: (time.sleep(0.5), index(*all))
IndexDataCacheFile._save_data = lambda *all: (time.sleep(delay), data(*all))

@kernel()
def half(x):
    return x / 2

@kernel()
def whole(x):
    return x

given = {"whole-int": (whole, 5), "whole-float": (whole, 5.5), "half-int": (half, 5), "half-float": (half, 5.5)}
print(json.dumps({name: given[name][0](given[name][1]) for name in sys.argv[1:]}))
"""
RESULTS = {"half-int": 2.5, "half-float": 2.75, "whole-int": 5, "whole-float": 5.5}


def started(folder, delay, *names):
    program = folder / "program.py"
    if not program.exists():
        program.write_text(PROGRAM)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, str(program), str(delay), *names]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def said(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return json.loads(out)


@pytest.mark.slow
@pytest.mark.parametrize("count", at_night([2, 4], {4}))
def test_processes_that_compile_at_once_do_not_mix_up_their_kernels(tmp_path, count):
    """Each process starts with another version; then all versions are loaded from disk, and none is compiled."""
    versions = list(RESULTS)[:count]
    processes = [started(tmp_path, 0.4 * (count - 1 - k), *versions[k:], *versions[:k]) for k in range(count)]
    results = [said(process) for process in processes]
    before = sorted(path.name for path in tmp_path.rglob("*.nbc"))
    results.append(said(started(tmp_path, 0.0, *versions)))
    assert sorted(path.name for path in tmp_path.rglob("*.nbc")) == before
    assert len(before) == count
    assert all(result == {name: RESULTS[name] for name in versions} for result in results)


@pytest.mark.parametrize("ending", at_night([".nbi", ".nbc"], {".nbi"}))
@pytest.mark.parametrize("left", at_night([0, 40], {0}))
def test_machine_code_that_was_cut_is_compiled_again(tmp_path, ending, left):
    assert said(started(tmp_path, 0.0, "half-int")) == {"half-int": 2.5}
    for path in tmp_path.rglob(f"*{ending}"):
        path.write_bytes(path.read_bytes()[:left])
    assert said(started(tmp_path, 0.0, "half-int")) == {"half-int": 2.5}
    whole = {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}
    assert len(whole) == 2
    assert said(started(tmp_path, 0.0, "half-int")) == {"half-int": 2.5}
    assert whole == {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}


INNER = """
from cornercase._common.numba.kernel import kernel
@kernel()
def inner(x):
    return later(x)
@kernel()
def later(x):
    return x + 1
"""
CODES = """
import enum
import numpy as np
TABLE = np.array([1.0, 2.0])
class Code(enum.IntEnum):
    FIRST = 0
"""
OUTER = """
import codes
from cornercase._common.numba.kernel import kernel
from inner import inner
LIMIT = 5.0
@kernel()
def outer(x):
    "That."
    # that
    if x > LIMIT:
        return codes.TABLE[codes.Code.FIRST]
    return inner(x)
"""
FILES = {"inner": INNER, "codes": CODES, "outer": OUTER}
# Text to replace, its replacement, and the kernel's new result; None if the cached code stays valid.
CHANGES = [
    ("inner", "x + 1", "x + 2", "3.0"),
    ("outer", "# that", "# that and more\n    # of it", None),
    ("outer", '"That."', '"Those."', None),
    ("outer", "LIMIT = 5.0", "LIMIT = 0.5", "1.0"),
    ("codes", "1.0,", "4.0,", "4.0"),
    ("codes", "FIRST = 0", "FIRST = 1", "2.0"),
    ("outer", "@kernel()", "@kernel(fastmath=True)", "2.0"),
]


def test_what_a_kernel_holds_is_in_its_digest(monkeypatch):
    """In its own module or in another one; comments and docstrings do not count."""

    def digest():
        for name, text in files.items():
            module = ModuleType(name)
            monkeypatch.setitem(sys.modules, name, module)
            exec(text, vars(module))
        outer = sys.modules["outer"].outer
        return kernel_digest(outer.py_func, outer.targetoptions)

    files, digests = dict(FILES), []
    digests.append(digest())
    assert digest() == digests[0]
    for name, before, after, gives in CHANGES:
        files[name] = files[name].replace(before, after)
        digests.append(digest())
        assert (digests[-1] == digests[-2]) == (gives is None)
    assert len(set(digests)) == 1 + sum(gives is not None for *_, gives in CHANGES)


@pytest.mark.slow
@pytest.mark.parametrize("kept_each_time", [False, True])
def test_a_kernel_is_compiled_again_when_what_it_holds_has_changed(tmp_path, kept_each_time):
    def printed():
        for name, text in files.items():
            (tmp_path / f"{name}.py").write_text(text)
        # Python does not notice that a file changed within a second if its size is the same.
        kept = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        environment = {**os.environ, **kept}
        command = [sys.executable, str(tmp_path / "outer.py")]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    files = {**FILES, "outer": f"{OUTER}\nprint(outer(1.0), sum(outer.stats.cache_hits.values()))\n"}
    given = "2.0"
    assert printed() == [given, "0"]
    for name, before, after, gives in CHANGES:
        files[name] = files[name].replace(before, after)
        given = gives or given
        assert printed() == [given, "1" if gives is None else "0"]
        if kept_each_time:
            assert printed() == [given, "1"]


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_the_fields_of_a_named_tuple_have_changed_places(tmp_path):
    program = (
        "from typing import NamedTuple\nfrom cornercase._common.numba.kernel import kernel\n"
        "class Place(NamedTuple):\n    {}: float\n    {}: float\n"
        "@kernel()\ndef read(place):\n    return place[0].x\n"
        "print(read((Place(x=1.0, y=2.0),)), sum(read.stats.cache_hits.values()))\n"
    )

    def printed(*names):
        (tmp_path / "reading.py").write_text(program.format(*names))
        # Both programs have the same size and age in seconds, so that Python would mix up their bytecode.
        unread = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        environment = {**os.environ, **unread}
        command = [sys.executable, "-c", "import reading"]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=tmp_path)
        return ran.stdout.split()

    assert [printed("x", "y"), printed("x", "y")] == [["1.0", "0"], ["1.0", "1"]]
    assert printed("y", "x") == ["1.0", "0"]


def test_a_global_without_a_digest_is_refused():
    function = FunctionType(compile("limits", "", "eval"), {"limits": [1.0], "__name__": __name__})
    with pytest.raises(TypeError, match="cannot be hashed"):
        kernel_digest(function, {})


def test_who_listens_hears_what_is_compiled_and_the_user_does_not(caplog):
    def double(x):
        return 2 * x

    doubled: Any = kernel()(double)
    # Kernels of earlier tests do not count once they are deleted.
    gc.collect()
    ready, known = count_ready_kernels()
    heard: list[str] = []
    with listen_to_compilation(heard.append):
        doubled._cache.flush()
        assert doubled(2) == 4
        assert doubled(3) == 6
    assert heard == [f"{__name__}.double"]
    assert count_ready_kernels() == (ready + 1, known)
    assert caplog.records == []


def test_a_full_disk_keeps_nobody_from_what_is_compiled(caplog, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def triple(x):
        return 3 * x

    tripled: Any = kernel()(triple)
    tripled._cache.flush()
    monkeypatch.setattr("numba.core.caching.FunctionCache.save_overload", refuse)
    monkeypatch.setattr(kernel_module._COMPILATION_LISTENER, "not_cached_reason", "")
    assert tripled(2) == 6
    assert "No space left on device" in reason_not_cached()
    assert "Compiled kernels cannot be cached" in caplog.text


def test_a_message_says_how_long_compiling_takes_and_others_that_it_goes_on(caplog):
    @kernel()
    def first(x):
        return x + 1

    @kernel()
    def second(x):
        return x + 2

    with event.install_listener("numba:compile", kernel_module._CompilationListener(seconds_between_messages=0.0)):
        compiled: Any
        for compiled in (first, second):
            compiled._cache.flush()
            compiled(1)
    assert "about a minute" in caplog.text
    assert "Still compiling: kernel 2, after" in caplog.text


COMPANION = """
from cornercase._common.numba.kernel import call_on_first_compilation, kernel
@kernel()
def one(x):
    return x + 1
@kernel()
def two(x):
    return x + 2
started = []
with call_on_first_compilation(lambda: started.append(1)):
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


LOWEST = """
import numpy as np
from cornercase._common.numba.kernel import kernel

@kernel()
def lowest(values, is_first):
    if is_first:
        return values[0]
    return values.min()

@kernel()
def both(values):
    return lowest(values, True), lowest(values, False)

print(*both(np.array([3, 1, 2])))
"""


def test_a_function_that_the_first_part_does_not_need_is_there_for_the_next(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    (tmp_path / "lowest.py").write_text(LOWEST)
    command = [sys.executable, str(tmp_path / "lowest.py")]
    for _ in ("compiled", "from the cache"):
        result = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert result.stdout == "3 1\n", result.stderr
