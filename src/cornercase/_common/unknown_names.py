"""Errors for unknown arguments and attributes that suggest the right name, also for names from other libraries."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import wraps
from inspect import signature
from typing import Any, Final, TypeVar, cast

from cornercase._common.errors import suggest_name

Function = TypeVar("Function", bound=Callable[..., Any])

_WORKERS: Final = "give `runs=Runs(workers=…)`."
# Arguments of other libraries: their name there, the option to give instead, and a hint if the option has another
# meaning.
_ARGUMENT_SYNONYMS: Final = (
    ("callbacks", "stop", "call `explore` in a loop with a growing `budget`, and do there what a callback would."),
    ("condition", "critical_if", ""),
    ("direction", "metrics", "each metric says whether low or high scores are critical."),
    ("drivers", "simulator", "the simulator holds them: give `simulator=Builtin(drivers={…})`."),
    ("load_if_exists", "problem", "use `Study.open_or_create`."),
    ("n_jobs", "runs", _WORKERS),
    ("n_jobs", "workers", ""),
    ("n_clusters", "eps", "clusters are found by density; a smaller `eps` splits them, a larger one merges them."),
    ("n_trials", "budget", ""),
    ("optimizer", "problem", "give it to `explore`."),
    ("runs", "workers", "give the options of Runs themselves, as in `workers=4`."),
    ("sampler", "optimizer", ""),
    ("sampler", "problem", "give it to `explore`, as `optimizer`."),
    ("stop", "stop_when", ""),
    ("threshold", "critical", ""),
    ("timeout", "stop", "give `stop=stop.seconds(…)`."),
    ("workers", "runs", _WORKERS),
)
_BEST: Final = "use `most_critical(1)`."
_EXPLORE: Final = "use `explore`."
_TABLE: Final = "use `table()`."
ATTRIBUTE_SYNONYMS: Final = {
    "analyze": "use `cluster`.",
    "best": _BEST,
    "best_params": _BEST,
    "best_trial": _BEST,
    "best_trials": "use `pareto_front()`.",
    "best_value": _BEST,
    "compare": "use `cornercase.compare(old, new)`.",
    "create_study": "use `Study.create`.",
    "fit": _EXPLORE,
    "get_param_importances": "use `sensitivity()`.",
    "importances": "use `sensitivity()`.",
    "load_study": "use `Study.open`.",
    "optimize": _EXPLORE,
    "plot": "use `report`.",
    "read_study": "use `Study.open`.",
    "results": _TABLE,
    "run": _EXPLORE,
    "to_csv": "use `table().to_csv(…)`.",
    "trials": _TABLE,
    "trials_dataframe": _TABLE,
    "worst": _BEST,
}


def unknown_attribute_error(owner: str, name: str) -> AttributeError:
    """Return the `AttributeError` for a missing attribute, with a hint if the name is used by another library."""
    hint = ATTRIBUTE_SYNONYMS.get(name)
    return AttributeError(f"{owner} has no attribute '{name}'{'' if hint is None else f'; {hint}'}", name=name)


def refuse_unknown_arguments(
    function: str, options: Collection[str], given: Collection[str], other_names: Mapping[str, str] | None = None
) -> None:
    """Raise `TypeError`, as Python does, if a keyword argument in `given` is not an option of the function.

    The message suggests the option that is probably meant. `other_names` maps names that are used in other interfaces
    to names of options.
    """
    for name in given:
        if name not in options:
            hint = _suggest_argument(name, options, other_names or {})
            raise TypeError(f"{function}() got an unexpected keyword argument '{name}'; {hint}")


def _suggest_argument(name: str, options: Collection[str], other_names: Mapping[str, str]) -> str:
    for word, option, hint in (*_ARGUMENT_SYNONYMS, *((word, option, "") for word, option in other_names.items())):
        if word == name and option in options:
            return hint or f"did you mean '{option}'?"
    return suggest_name(name, options) if options else "it takes none."


def suggest_arguments(function: Function, other_names: Mapping[str, str] | None = None) -> Function:
    """Decorate a function so that the error for an unknown keyword argument suggests the right name.

    `other_names` maps names that are used in other interfaces to names of arguments.
    """
    parameters = [name for name in signature(function).parameters if name not in ("self", "cls")]

    @wraps(function)
    def call(*positional: Any, **given: Any) -> Any:
        refuse_unknown_arguments(function.__qualname__.removesuffix(".__init__"), parameters, given, other_names)
        return function(*positional, **given)

    return cast(Function, call)
