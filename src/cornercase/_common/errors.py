"""Exceptions and warnings that users meet."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Iterator
from contextlib import ContextDecorator, contextmanager
from typing import Final

# errno values that mean that the machine is at fault.
_MACHINE_ERRNOS: Final = {
    errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EIO, errno.EROFS,
}  # fmt: skip


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence that names the file, the element and the fix. It puts a parameter of a public function
    between backticks (```stop_when```), which the command line replaces by its option (``--stop-when``). The command
    line prints the message and exits with code 2.

    Examples
    --------
    >>> import cornercase as cc
    >>> try:
    ...     cc.simulate("examples/r157/cut_in.xosc", {"gaps": 20.0})
    ... except cc.InputError as error:
    ...     print(error)
    examples/r157/cut_in.xosc: declares no parameter 'gaps'; did you mean 'gap'?
    """


class ExpressionError(InputError):
    """A formula, a requirement or a condition that cannot be read.

    Parameters
    ----------
    sentence : str
        What is wrong, and what to write instead.
    excerpt : str, optional
        Two more lines of the message: the text of the expression, and a caret below the error.

    Attributes
    ----------
    excerpt : str

    Examples
    --------
    >>> from cornercase.metrics import Expression, ExpressionError
    >>> try:
    ...     Expression.parse("ttc > 1.5 m")
    ... except ExpressionError as error:
    ...     print(error)
    The formula cannot be read: ttc is in s: the unit 'm' does not fit; give s, ms, min.
        ttc > 1.5 m
                  ^
    """

    def __init__(self, sentence: str, excerpt: str = "") -> None:
        super().__init__(f"{sentence}\n{excerpt}" if excerpt else sentence)
        self.excerpt = excerpt


class UserCodeError(InputError):
    """The user's own code raised an exception, which is the `__cause__` of this one.

    The message names the part, such as the optimizer or the metric, and the exception.

    Examples
    --------
    >>> from cornercase.exploration import UserCodeError
    >>> try:  # doctest: +SKIP
    ...     study.explore(MySearch(), budget=100)
    ... except UserCodeError as error:
    ...     print(repr(error.__cause__))
    """


class SimulationError(RuntimeError):
    """One concrete scenario could not be run; the others of its batch are not affected.

    Examples
    --------
    A simulator of one's own yields it in place of a recording:

    >>> import cornercase as cc
    >>> class WithoutRain(cc.Simulator):
    ...     settings = {}
    ...
    ...     def run(self, concretes):
    ...         yield from (cc.SimulationError("rain is not simulated") for concrete in concretes)
    >>> cc.simulate("examples/r157/cut_in.xosc", simulator=WithoutRain())
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: examples/r157/cut_in.xosc: rain is not simulated.
    """


class SimulatorError(SimulationError):
    """The simulator failed, not the scenario; the same scenario may be run again.

    Examples
    --------
    A simulator of one's own yields it in place of a recording:

    >>> import cornercase as cc
    >>> class Remote(cc.Simulator):
    ...     settings = {}
    ...
    ...     def run(self, concretes):
    ...         yield from (cc.SimulatorError("the licence server does not answer") for concrete in concretes)
    >>> cc.simulate("examples/r157/cut_in.xosc", simulator=Remote())
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: examples/r157/cut_in.xosc: the licence server does not answer, tried 2 times.
    """


class PluginError(SimulationError):
    """A user's driver, simulator or metric raised an exception or gave an unusable result in one scenario."""


class StudyLostError(RuntimeError):
    """The study that is being written was removed, replaced, or taken over by another process.

    The command line prints the message and exits with code 1.
    """


class RunLostError(SimulatorError):
    """Something outside ended a run: a signal, lack of memory or a full disk. The scenario may be run again."""


class NoticeWarning(UserWarning):
    """A part of the input has no effect, or is read differently from how it is written.

    Examples
    --------
    >>> import warnings
    >>> import cornercase as cc
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", cc.NoticeWarning)
    ...     recording = cc.simulate("examples/r157/cut_in.xosc", duration=1.0)
    """


def is_machine_error(error: BaseException | None) -> bool:
    """Whether an error, or its cause, is a fault of the machine: full or broken disk, no memory or no file handles."""
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _MACHINE_ERRNOS):
            return True
        error = error.__cause__
    return False


class short_errors(ContextDecorator):  # noqa: N801
    """Context manager or decorator at the border of the API: the traceback of an `InputError` ends there.

    Causes are left out, unless the user's code or the machine is at fault.
    """

    def edit(self, message: str) -> str:
        """Return the message for the user."""
        return message

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(self, _: object, error: BaseException | None, traceback: object) -> None:
        """Raise the error that the user sees."""
        if isinstance(error, InputError):
            error.args = (self.edit(str(error)), *error.args[1:])
            is_cause_of_interest = isinstance(error, UserCodeError) or is_machine_error(error)
            raise error.with_traceback(None) from (error.__cause__ if is_cause_of_interest else None)


@contextmanager
def skip_if_not_enough_data() -> Iterator[None]:
    """Suppress a `ValueError` in the block, which says that there are too few data; let an `InputError` pass."""
    try:
        yield
    except InputError:
        raise
    except ValueError:
        pass


def suggest_name(unknown: str, valid_names: Iterable[str]) -> str:
    """Return a hint for an unknown name: ``"did you mean 'wttc'?"``, or ``"known are: …"`` if no name is similar."""
    names = sorted(valid_names)
    # Names are case-sensitive; a different case is probably the same name.
    by_casefold = {name.casefold(): name for name in reversed(names)}
    close = difflib.get_close_matches(unknown, names, n=1) or [
        by_casefold[folded] for folded in difflib.get_close_matches(unknown.casefold(), by_casefold, n=1)
    ]
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known are: {', '.join(names)}." if names else "none are known."
