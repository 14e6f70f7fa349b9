"""The search problem: a logical scenario, the entity under test, and what counts as critical."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, hide_input_error_traceback
from cornercase._common.text.notebook_html import render_html
from cornercase._common.unknown_names import Function
from cornercase._common.unknown_names import suggest_arguments as suggest_names
from cornercase._common.validation import repr_short
from cornercase.exploration._config import ExplorationConfig, read_logical_scenario, read_study_metrics
from cornercase.exploration._constant_metrics import warn_about_threshold
from cornercase.metrics import Expression, Metric
from cornercase.scenario import LogicalScenario
from cornercase.study import StudyFile
from cornercase.study._import_recordings import IMPORTED_SIMULATOR

# Names of arguments and methods of `Problem` and `Study`, by the names that functions such as `explore` use instead.
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

# The drivers of a `Study` belong to its simulator.
_DRIVER_HINT: Final = re.compile("give it again with `drivers`")
_DRIVER_EXAMPLE: Final = re.compile(r"Study\.open, as in (\{.*\})")


def suggest_arguments(function: Function) -> Function:
    """Make the error for an unknown argument suggest a name; it translates option names of `explore`, too."""
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
        Criticality metrics: objects from `cornercase.metrics`, texts with options after a colon, or objects of your own
        class derived from `cornercase.Metric`. All are stored; the first is searched unless `weights` are given.
    threshold : float, optional
        Score from which a scenario is critical, in the unit of the objective. Default: the metric's own threshold.
    condition : str or Expression, optional
        Condition that replaces metric and threshold, and is searched: ``"collision and not reference:cc-human"``, where
        ``reference:NAME`` says that the ego would also collide if this driver drove it. The language is the same as for
        formulas and requirements. But a bound outside of temporal operators, such as ``ttc < 1``, refers to the score
        of the metric.
    weights : mapping of str to float, optional
        Weight of each metric, above 0: the minimum of the weighted sum of the scores is searched. Scores that are
        critical when high are subtracted; give a positive weight for them, too.
    pareto : bool, default False
        Search the Pareto front of all metrics. The optimizers ``Evolutionary()`` and ``Optuna("nsga2")`` can do this;
        ``Sobol()``, ``Grid()`` and ``Random()`` sample the space independently of the scores.

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
        with rename_arguments_in_errors():
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
        """Describe in a few words what counts as critical, or what is searched."""
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
    """Return an expression as text; `InputError` if the text, read as a condition, means something else."""
    if Expression.parse(expression.text, "condition").root != expression.root:
        raise InputError(
            f"`condition` {expression}: was parsed as a formula, but as a condition this text means something else,"
            ' since a bound then refers to the score of the metric; parse it with the language "condition", or write'
            " always(…)."
        )
    return expression.text


def problem_from_study(study: StudyFile, scenario: Path | None) -> Problem:
    """Return the search problem of a study; `scenario` is the explored file.

    A metric of the user's own class is only described, without its code.
    """
    meta = study.meta
    if meta.simulator == IMPORTED_SIMULATOR:
        raise InputError(
            f"{study.path}: contains imported recordings instead of runs of a scenario file, so it has no search"
            " problem; `summary` says what was measured."
        )
    return Problem(
        read_logical_scenario(study, scenario),
        meta.ego,
        meta.other,
        read_study_metrics(meta),
        None if meta.condition else meta.critical,
        meta.condition or None,
        meta.weights,
        meta.pareto,
    )


def config_from_problem(problem: Problem, **settings: Any) -> ExplorationConfig:
    """Create the configuration for exploring a problem; `settings` are the options that the problem does not hold."""
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


class rename_arguments_in_errors(hide_input_error_traceback):  # noqa: N801
    """Context manager that hides tracebacks of input errors, and replaces names of arguments in their messages.

    Options of `explore` get the names that `Problem` and `Study` use: `` `threshold` `` instead of `` `critical` ``.
    """

    def edit(self, message: str) -> str:
        """Replace names of arguments between backticks, and hints that do not apply to methods of `Study`."""
        # Methods of an object do not take the file of the study or scenario as an argument.
        message = message.replace("name another study with `study`", "create another study")
        message = message.replace("name it with `scenario`", "name it as in Study.open(…, scenario=…)")
        message = message.replace("give it again with `simulator`", "give it again as in Study.open(…, simulator=…)")
        message = _DRIVER_HINT.sub("give it again in the `simulator` of Study.open", message)
        message = _DRIVER_EXAMPLE.sub(r"Study.open, as in Builtin(drivers=\1)", message)
        return re.sub(r"`(\w+)`", lambda match: f"`{_NAME_IN_OBJECTS.get(match[1], match[1])}`", message)
