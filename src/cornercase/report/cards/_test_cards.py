"""Test cards: an HTML page that prints one scenario on each A4 page, for people who drive it on a proving ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase.reduction import read_reduction
from cornercase.report.cards._card_contents import CardSource, describe_entity_under_test, make_card_values
from cornercase.report.cards._rounded_runs import (
    CardRun,
    RoundedRun,
    RoundedRunner,
    read_stored_run,
    reason_not_to_run,
)
from cornercase.report.cards._rounding import count_roundings, iter_roundings
from cornercase.report.cards._settable_quantity import SettableQuantity, find_settable_quantity
from cornercase.report.cards._tolerances import SOURCE
from cornercase.report.html._templates import check_page_path, render_template, write_page
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study

# Most pages that somebody may want to print.
_MAX_CARDS: Final = 500
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"

_ChooseRounding = Callable[[CardRun], RoundedRun]


def write_test_cards(
    study: StudyFile | Path | str,
    path: Path | str,
    *,
    ids: Sequence[int] | None = None,
    scenario: Path | str | None = None,
    critical: float | None = None,
) -> Path:
    """Write test cards: an HTML page without scripts that prints one scenario on each A4 page, for proving grounds.

    The parameters are rounded to steps that a proving ground can set: speeds to 1 km/h (0.1 km/h if the range is
    narrower than 5 km/h), distances to 0.1 m, times to 0.1 s. If the study's simulator is ``"builtin"`` or
    ``"esmini"``, each scenario is run again with the rounded values where possible, and the card says whether this run
    ends as in the study. If not, other roundings up or down are tried, at most the nearest 64. The card shows the
    nearest rounding that ends as in the study, or says that there is none.

    Parameters
    ----------
    study : StudyFile or path
        An open study, or its file; it is only read.
    path : path
        HTML file to write; its name ends with ``.html`` or ``.htm``.
    ids : sequence of int, optional
        Ids of scenarios. By default the reduced set. If the study ran a suite and has no reduced set, all scenarios
        that ran.
    scenario : path, optional
        OpenSCENARIO file that was explored, if it is not found beside the study.
    critical : float, optional
        Threshold of the score from which a scenario is critical, in the unit of the objective. By default the
        threshold of the study.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        There is no such study or scenario, the study has no reduced set and `ids` are missing, or `path` cannot be
        written.

    See Also
    --------
    cornercase.write_report : The report of a study.
    cornercase.reduction.reduce : Selects the scenarios.

    Examples
    --------
    >>> from cornercase.report import write_test_cards
    >>> write_test_cards("study.db", "cards.html", ids=[3, 17])  # doctest: +SKIP
    PosixPath('cards.html')
    """
    path = validation.check_path("path", path)
    check_page_path(path, "set of test cards")
    with open_study(study, readonly=True, critical=critical) as opened, opened.snapshot():
        check_output_differs_from_source(path, opened.path)
        page = _render_cards(opened, _choose_ids(opened, ids), scenario)
    write_page(path, page)
    return path


def _choose_ids(study: StudyFile, ids: Sequence[int] | None) -> list[int]:
    finished = {row.id for row in study.finished_rows()}
    if ids is None:
        reduced = read_reduction(study)
        if reduced is None and not study.meta.suite:
            raise InputError(
                f"{study.path}: no scenarios were selected yet, so there are no test cards; run 'cornercase reduce', or"
                " name scenarios with `ids`."
            )
        ids = sorted(finished) if reduced is None else [scenario.id for scenario in reduced.scenarios]
    chosen = list(dict.fromkeys(validation.check_int("ids", scenario, 1) for scenario in ids))
    if not chosen:
        raise InputError(f"{study.path}: there are no scenarios to write test cards for; name some with `ids`.")
    if len(chosen) > _MAX_CARDS:
        raise InputError(f"`ids`: {len(chosen)} test cards are too many to print; name at most {_MAX_CARDS}.")
    missing = [scenario for scenario in chosen if scenario not in finished]
    if missing:
        raise InputError(
            f"{study.path}: scenario {missing[0]} was not run, or does not exist; give `ids` of run scenarios."
        )
    return chosen


def _render_cards(study: StudyFile, ids: Sequence[int], given: Path | str | None) -> str:
    meta = study.meta
    scenario, reason = _find_scenario(study, given)
    reason = reason_not_to_run(meta) or reason
    quantities = [find_settable_quantity(parameter, scenario) for parameter in meta.space.parameters]
    reduced = read_reduction(study)
    selected = {} if reduced is None else {entry.id: entry for entry in reduced.scenarios}
    rows = {row.id: row for row in study.finished_rows()}
    cards = []
    with ExitStack() as stack:
        choose = _make_rounding_chooser(study, scenario, quantities, reason, stack)
        for scenario_id in ids:
            original = read_stored_run(study, scenario_id, rows[scenario_id].values)
            entry = selected.get(scenario_id)
            source = CardSource(
                scenario_id,
                original,
                choose(original),
                "" if entry is None else str(entry.role),
                "" if entry is None else entry.why,
            )
            cards.append(make_card_values(study, source, scenario, quantities))
    return render_template(
        "test-cards.html.j2",
        ("test-cards.css",),
        (),
        policy=_POLICY,
        title=shorten(escape_control_characters(meta.title), 40),
        cards=cards,
        tolerance_source=SOURCE,
        **_shared_template_values(study),
    )


def _find_scenario(study: StudyFile, given: Path | str | None) -> tuple[ScenarioFile | None, str]:
    """Return the explored file, or None and why it was not found; InputError if `given` is not the explored file.

    For imported recordings, which have no such file, the reason is empty.
    """
    try:
        return find_explored_scenario(study, given), ""
    except InputError:
        if given is not None:
            raise
        return None, f"the scenario file {study.meta.file_name} was not found as it was explored"


def _make_rounding_chooser(
    study: StudyFile,
    scenario: ScenarioFile | None,
    quantities: Sequence[SettableQuantity],
    reason: str,
    stack: ExitStack,
) -> _ChooseRounding:
    """Return a function that chooses the rounding of a run.

    If `reason` says why scenarios cannot be run, the function takes the nearest rounding without running it.
    """
    parameters, runner = study.meta.space.parameters, None
    if not reason and scenario is not None:
        try:
            runner = stack.enter_context(RoundedRunner(study, scenario))
        except InputError as error:
            reason = str(error).rstrip(".")

    def choose(original: CardRun) -> RoundedRun:
        roundings = list(iter_roundings(parameters, quantities, original.values))
        n_possible = count_roundings(parameters, quantities, original.values)
        if runner is None:
            return RoundedRun(roundings[0].values, None, None, 0, n_possible, reason=reason)
        return runner.choose_rounding(original, roundings, n_possible)

    return choose


def _shared_template_values(study: StudyFile) -> dict[str, Any]:
    meta = study.meta
    return {
        "file_name": shorten(escape_control_characters(study.path.name), 40),
        "function": describe_entity_under_test(study),
        "simulator": shorten(escape_control_characters(meta.simulator), 40),
        "fingerprint": meta.fingerprint[:16],
        "version": meta.version,
    }
