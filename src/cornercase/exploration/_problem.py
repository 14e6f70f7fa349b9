"""The search problem: a logical scenario, the entity under test, and what counts as critical."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, short_errors
from cornercase._common.text.notebook_html import render_html
from cornercase._common.unknown_names import Function
from cornercase._common.unknown_names import suggest_arguments as suggest_names
from cornercase._common.validation import repr_short
from cornercase.exploration._config import ExplorationConfig, metrics_to_continue, read_logical_scenario
from cornercase.exploration._constant_metrics import warn_about_threshold
from cornercase.metrics import Expression, Metric
from cornercase.scenario import LogicalScenario
from cornercase.study import StudyFile
from cornercase.study._import_recordings import IMPORTED_SIMULATOR

# Arguments and verbs of the objects, by their name in the functions.
_NAME_IN_OBJECTS: Final = {
    "analyze": "cluster",
    "critical": "threshold",
    "critical_if": "condition",
    "output": "path",
    "id": "scenario",
    "max_failures": "runs=Runs(max_failures=…)",
    "stop_when": "stop",
    "study": "path",
}

# Objects hold drivers in their simulator.
_DRIVER_HINT: Final = re.compile("give it again with `drivers`")
_DRIVER_EXAMPLE: Final = re.compile(r"Study\.open, as in (\{.*\})")


def suggest_arguments(function: Function) -> Function:
    """Like the decorator in `_common`, also for names of options of the functions."""
    return suggest_names(function, _NAME_IN_OBJECTS)


@dataclass(frozen=True, repr=False)
class Problem:
    """A search problem: a logical scenario, the entity under test, and what counts as critical.

    Parameters
    ----------
    scenario : LogicalScenario
        Scenario and the ranges of its parameters.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entities that the ego is measured against; the most critical one counts. ``"*"`` means all others.
    metrics : Metric or str, or sequence of these
        Criticality metrics from `cornercase.metrics`, or as text with options after a colon; or objects of your own
        class, derived from `cornercase.Metric`. All are stored; the first is searched unless `weights` are given.
    threshold : float, optional
        Score from which a scenario is critical, in the unit of the objective. Default: the metric's own.
    condition : str or Expression, optional
        Condition that replaces metric and threshold, and is searched: ``"collision and not reference:cc-human"``, where
        ``reference:NAME`` says that the ego would also collide if this driver drove it. An expression of the same
        language as formulas and requirements; outside of temporal operators, a bound such as ``ttc < 1`` is on the
        score.
    weights : mapping of str to float, optional
        By metric, above 0: search the minimum of the weighted sum of the scores. A score that is critical when high is
        subtracted; its weight is positive, too.
    pareto : bool, default False
        Search the Pareto front of all metrics. Of the optimizers, ``Evolutionary()`` and ``Optuna("nsga2")`` search it;
        ``Sobol()``, ``Grid()`` and ``Random()`` sample the space regardless.

    Raises
    ------
    InputError
        The scenario lacks an entity, there is no such metric, or the arguments contradict each other.

    Examples
    --------
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], threshold=0.2)
    <Problem 'x_intersection': Ego and Pedestrian, critical if wttc <= 0.2 s>
    """

    scenario: LogicalScenario
    ego: str
    other: str | Sequence[str]
    metrics: Metric | str | Sequence[Metric | str]
    threshold: float | None = None
    condition: str | Expression | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    pareto: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.scenario, LogicalScenario):
            raise InputError(
                f"`scenario` {repr_short(self.scenario)}: give a scenario that `LogicalScenario.read` has read."
            )
        if isinstance(self.condition, Expression):
            object.__setattr__(self, "condition", _condition_text(self.condition))
        with name_arguments_of_objects():
            config = config_from_problem(self)
            config.require_entities()
            warn_about_threshold(config.make_objective(), "threshold")
        for name in ("other", "metrics", "weights"):
            object.__setattr__(self, name, getattr(config, name))
        object.__setattr__(self, "threshold", config.critical)

    def __repr__(self) -> str:
        others = self.other if isinstance(self.other, str) else ", ".join(self.other)
        return f"<Problem {self.scenario.path.stem!r}: {self.ego} and {others}, {self._criterion()}>"

    def _criterion(self) -> str:
        """What counts as critical, or what is searched, in a few words."""
        if self.condition is not None:
            return f"critical if {self.condition}"
        objective = config_from_problem(self).make_objective()
        if objective.criterion is None:
            return f"searched by {objective.label}"
        return f"critical if {objective.label} {objective.criterion}"

    def _repr_html_(self) -> str:
        """HTML description with a table of the parameters, for notebooks."""
        return render_html(repr(self), self.scenario.space._repr_html_())


Problem.__init__ = suggest_arguments(Problem.__init__)  # type: ignore[method-assign]


def _condition_text(expression: Expression) -> str:
    """Return the text of a condition; InputError if as a condition it means something else than the expression."""
    if Expression.parse(expression.text, "condition").root != expression.root:
        raise InputError(
            f"`condition` {expression}: is a formula, and in a condition a bound is on the score; parse it with the"
            ' language "condition", or write always(…).'
        )
    return expression.text


def problem_from_study(study: StudyFile, scenario: Path | None) -> Problem:
    """Return the search problem of a study, without the user's own code; `scenario` is the explored file."""
    meta = study.meta
    if meta.simulator == IMPORTED_SIMULATOR:
        raise InputError(
            f"{study.path}: contains imported recordings, which no scenario file made, so there is no search problem;"
            " `summary` says what was measured."
        )
    return Problem(
        read_logical_scenario(study, scenario),
        meta.ego,
        meta.other,
        metrics_to_continue(meta),
        None if meta.condition else meta.critical,
        meta.condition or None,
        meta.weights,
        meta.pareto,
    )


def config_from_problem(problem: Problem, **settings: Any) -> ExplorationConfig:
    """Create the configuration of an exploration of a problem; `settings` are all other options."""
    return ExplorationConfig(
        logical=problem.scenario,
        ego=problem.ego,
        other=problem.other,
        metrics=problem.metrics,
        critical=problem.threshold,
        critical_if=None if problem.condition is None else str(problem.condition),
        weights=problem.weights,
        pareto=problem.pareto,
        **settings,
    )


class name_arguments_of_objects(short_errors):  # noqa: N801
    """Like `short_errors`; messages name the arguments of `Problem`: `` `threshold` `` instead of `` `critical` ``."""

    def edit(self, message: str) -> str:
        """Replace the names between backticks, and hints for functions."""
        # A verb of an object names no file.
        message = message.replace("name another study with `study`", "create another study")
        message = message.replace("name it with `scenario`", "name it as in Study.open(…, scenario=…)")
        message = message.replace("give it again with `simulator`", "give it again as in Study.open(…, simulator=…)")
        message = _DRIVER_HINT.sub("give it again in the `simulator` of Study.open", message)
        message = _DRIVER_EXAMPLE.sub(r"Study.open, as in Builtin(drivers=\1)", message)
        return re.sub(r"`(\w+)`", lambda match: f"`{_NAME_IN_OBJECTS.get(match[1], match[1])}`", message)
