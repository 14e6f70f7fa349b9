"""How scenarios are run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.option import document_options
from cornercase.exploration._explore_options import CONFIG_OPTIONS
from cornercase.simulators._run_options import RUN_OPTIONS, RunOptions

_OPTIONS: Final = {name: CONFIG_OPTIONS[name] for name in (*RUN_OPTIONS, "repeats", "max_repeats")}


@document_options(_OPTIONS)
@dataclass(frozen=True, kw_only=True, repr=False)
class Runs(RunOptions):
    """How scenarios are run: where, how often, and what happens if a simulator dies or hangs.

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
        changed = [f"{name}={value!r}" for name, value in vars(self).items() if value != getattr(Runs, name)]
        return f"Runs({', '.join(changed)})"


def single_run_settings(runs: Runs | None, user: str) -> dict[str, Any]:
    """Return the settings of `runs` by name for `user`, which runs each scenario once."""
    runs = Runs() if runs is None else runs
    if runs.repeats != 1 or runs.max_repeats not in (None, 1):
        raise InputError(f"`runs`: {user} runs each scenario once; leave out `repeats` and `max_repeats`.")
    return {name: value for name, value in vars(runs).items() if name not in ("repeats", "max_repeats")}
