"""Options of how scenarios are run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.option import document_options
from cornercase._common.unknown_names import suggest_arguments
from cornercase._common.validation import not_an_object_error
from cornercase.exploration._explore_options import CONFIG_OPTIONS
from cornercase.simulators._run_options import RUN_OPTIONS, RunOptions

_OPTIONS: Final = {name: CONFIG_OPTIONS[name] for name in (*RUN_OPTIONS, "repeats", "max_repeats")}


@document_options(_OPTIONS)
@dataclass(frozen=True, kw_only=True, repr=False)
class Runs(RunOptions):
    """Options of how scenarios are run: where, how often, and what happens if a simulator dies or hangs.

    Parameters
    ----------
    OPTIONS

    Raises
    ------
    InputError
        An argument has another type, or is out of range.

    Examples
    --------
    >>> from cornercase import Runs
    >>> Runs(workers=4, timeout=60.0)
    Runs(workers=4, timeout=60.0)
    """

    repeats: int = 1
    max_repeats: int | None = None

    def __post_init__(self) -> None:
        for name, option in _OPTIONS.items():
            option.check(getattr(self, name))

    def __repr__(self) -> str:
        changed = [f"{name}={value!r}" for name, value in run_settings(self).items()]
        return f"Runs({', '.join(changed)})"


Runs.__init__ = suggest_arguments(Runs.__init__)  # type: ignore[method-assign]


def run_settings(runs: Runs | None) -> dict[str, Any]:
    """Return the settings of `runs` that differ from their defaults, by name; empty for None.

    Defaults are left out, so that a study that is continued keeps its own settings. Raises `InputError` if `runs` is
    not a `Runs` object.
    """
    if runs is None:
        return {}
    if not isinstance(runs, Runs):
        raise not_an_object_error("runs", runs, "give them as in Runs(workers=4)")
    return {name: value for name, value in vars(runs).items() if value != getattr(Runs, name)}


def single_run_settings(runs: Runs | None, caller: str) -> dict[str, Any]:
    """Return the settings of `runs` by name, for a function that runs each scenario once.

    Raises `InputError` if runs are to be repeated. `caller` is the subject of the message, such as "a suite".
    """
    settings = run_settings(runs)
    if settings.pop("repeats", 1) != 1 or settings.pop("max_repeats", 1) != 1:
        raise InputError(f"`runs`: {caller} runs each scenario once; leave out `repeats` and `max_repeats`.")
    return settings
