"""The kinds of failure that a user of cornercase meets."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Final

# What an OSError says where the machine is at fault.
_OF_THE_MACHINE: Final = {
    errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EIO, errno.EROFS,
}  # fmt: skip


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence that names the file, the element and the fix. A parameter of a public function
    stands in it between backticks (```stop_when```), where the command line puts its option (``--stop-when``). The
    command line prints the message and ends with exit code 2.
    """


class SimulationError(RuntimeError):
    """One concrete scenario could not be run; the others of its batch are not affected."""


class SimulatorError(SimulationError):
    """The simulator failed, not the scenario; the same scenario may be run again."""


class PartError(SimulationError):
    """A driver, a simulator or a metric raised an exception, or gave no usable result, in one concrete scenario."""


class StudyLostError(RuntimeError):
    """The study that is written is gone, was replaced, or was taken over by another process.

    The command line prints the message and ends with exit code 1.
    """


class LostError(SimulatorError):
    """Something outside ended a run: a signal, a lack of memory or of disk. The scenario may be run again."""


class NoticeWarning(UserWarning):
    """Something has no effect, or is not what it is said to be."""


def is_of_the_machine(error: BaseException | None) -> bool:
    """Tell whether an error, or what caused it, is one of the machine, and not of what it was at.

    Parameters
    ----------
    error : BaseException or None

    Returns
    -------
    bool
        True for a full or broken disk, and for want of memory or handles.
    """
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _OF_THE_MACHINE):
            return True
        error = error.__cause__
    return False


@contextmanager
def left_out_if_too_little() -> Iterator[None]:
    """Go on after a block that ends in a `ValueError`, as there are too few numbers to say something.

    An `InputError` is none of these, although it is a `ValueError`: that a study is damaged is not left out.

    Yields
    ------
    None

    Raises
    ------
    InputError
        The block raised it.
    """
    try:
        yield
    except InputError:
        raise
    except ValueError:
        pass


def suggestion(word: str, known: Iterable[str]) -> str:
    """Say what could have been meant by an unknown name.

    Parameters
    ----------
    word : str
        The name that is not known.
    known : iterable of str
        The names that are.

    Returns
    -------
    str
        ``"did you mean 'wttc'?"`` where one is close, else ``"known are: …"``.
    """
    names = sorted(known)
    # Names are told apart by case; who does not know that means the same.
    alike = {name.casefold(): name for name in reversed(names)}
    close = difflib.get_close_matches(word, names, n=1) or [
        alike[one] for one in difflib.get_close_matches(word.casefold(), alike, n=1)
    ]
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known are: {', '.join(names)}." if names else "none are known."
