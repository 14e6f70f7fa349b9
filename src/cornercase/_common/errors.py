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

    The message is one sentence that names the file, the element and the fix. Parameters of public functions stand
    between backticks (```stop_when```). The command line replaces them by options (``--stop-when``), prints the message
    and exits with code 2.

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
    """Formula, requirement or condition that cannot be read.

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
    """Failure of the user's own code; the exception that this code raised is the `__cause__` of the error.

    The message names the failed part, such as the optimizer or the metric, and the exception.

    Examples
    --------
    >>> from cornercase.exploration import UserCodeError
    >>> try:  # doctest: +SKIP
    ...     study.explore(MySearch(), budget=100)
    ... except UserCodeError as error:
    ...     print(repr(error.__cause__))
    """


class SimulationError(RuntimeError):
    """Failure of one concrete scenario that could not be run; other scenarios are not affected.

    Examples
    --------
    A simulator that you write yields this error in place of a recording:

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
    """Failure of the simulator, not of the scenario; the same scenario may be run again.

    Examples
    --------
    A simulator that you write yields this error in place of a recording:

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
    """Failure of a user's driver, simulator or metric in one scenario: an exception or an unusable result."""


class StudyLostError(RuntimeError):
    """Loss of the study that is being written: it was removed, replaced, or taken over by another process.

    The command line prints the message and exits with code 1.
    """


class RunLostError(SimulatorError):
    """Simulation that was ended by a signal, the loss of a worker, or a fault of the machine, such as a full disk.

    The scenario may be run again.
    """


class NoticeWarning(UserWarning):
    """Warning that a part of the input has no effect, or is read differently from how it is written.

    Examples
    --------
    >>> import warnings
    >>> import cornercase as cc
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", cc.NoticeWarning)
    ...     recording = cc.simulate("examples/r157/cut_in.xosc", duration=1.0)
    """


def is_machine_error(error: BaseException | None) -> bool:
    """Return whether an error or its cause is a fault of the machine, such as a full disk or lack of memory."""
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _MACHINE_ERRNOS):
            return True
        error = error.__cause__
    return False


class hide_input_error_traceback(ContextDecorator):  # noqa: N801
    """Context manager or decorator for public functions: raise an `InputError` without cornercase's own traceback.

    The cause of the error is hidden, too, unless the user's code or the machine is at fault.
    """

    def edit(self, message: str) -> str:
        """Return the error message that the user sees, unchanged here; a subclass may change the message."""
        return message

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(self, _: object, error: BaseException | None, traceback: object) -> None:
        """Raise an `InputError` again, with the edited message and without its traceback."""
        if isinstance(error, InputError):
            error.args = (self.edit(str(error)), *error.args[1:])
            is_cause_of_interest = isinstance(error, UserCodeError) or is_machine_error(error)
            raise error.with_traceback(None) from (error.__cause__ if is_cause_of_interest else None)


@contextmanager
def skip_if_not_enough_data() -> Iterator[None]:
    """Within the block, suppress a `ValueError`, which means that there are too few data, but not an `InputError`."""
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
