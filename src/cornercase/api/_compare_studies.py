"""Comparison of two studies, with a page that shows the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from cornercase import suite
from cornercase._common.errors import hide_input_error_traceback
from cornercase._common.validation import check_path
from cornercase.api._study import Study
from cornercase.api._written_page import Page
from cornercase.exploration._problem import rename_arguments_in_errors, suggest_arguments
from cornercase.report import write_comparison


@dataclass(frozen=True, repr=False)
class Comparison(suite.Comparison):
    """Result of a comparison of two versions of a system under test; as a bool, True if the versions differ at all.

    `cornercase.suite.Comparison` describes the other attributes and methods.

    Attributes
    ----------
    studies : tuple of (Path, Path)
        Paths of the studies that were compared: old, new.

    Examples
    --------
    >>> import cornercase as cc
    >>> comparison = cc.compare("old.db", "new.db")  # doctest: +SKIP
    >>> bool(comparison), comparison.verdict  # doctest: +SKIP
    (True, 'mixed')
    >>> comparison.write("compare.html")  # doctest: +SKIP
    <Page 'compare.html'>
    """

    studies: tuple[Path, Path] = field(kw_only=True)

    def write(self, path: Path | str) -> Page:
        """Write the page of the comparison: verdict, changes, charts, and replays of example scenarios.

        Parameters
        ----------
        path : path
            HTML file to write. The same comparison gives the same bytes.

        Returns
        -------
        Page
            The written page; a notebook shows it.

        Raises
        ------
        InputError
            The file cannot be written, or a study cannot be read.
        """
        return Page(write_comparison(self, *self.studies, path))


@hide_input_error_traceback()
@suggest_arguments
def compare(
    old: Study | suite.SuiteResult | Path | str,
    new: Study | suite.SuiteResult | Path | str,
    *,
    metrics: str | Sequence[str] | None = None,
    threshold: float | None = None,
    tolerances: Mapping[str, float] | None = None,
) -> Comparison:
    """Compare two versions of the system under test, and decide whether the new version is better or worse.

    Parameters
    ----------
    old, new : Study, SuiteResult or path
        Studies of the same scenario, parameter space and entities. Drivers, simulators, versions and time steps may
        differ. For a `SuiteResult`, its study is compared.
    metrics : str or sequence of str, optional
        Metrics to compare by. By default all metrics; both studies must then have the same metrics.
    threshold : float, optional
        Score from which a scenario is critical, for this comparison only. By default the threshold of each study; both
        must then be equal.
    tolerances : mapping of str to float, optional
        Largest change of a score that does not count, by metric, in the unit of the metric.
        `cornercase.suite.compare` lists the defaults.

    Returns
    -------
    Comparison
        `verdict` says whether the new version is better, worse, mixed or the same, or that the data do not allow a
        verdict.

    Raises
    ------
    InputError
        The studies cannot be compared; `cornercase.suite.compare` lists the reasons.

    See Also
    --------
    cornercase.suite.compare : Says how scenarios are compared, and how the verdict is decided.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.compare("old.db", "new.db").write("compare.html")  # doctest: +SKIP
    <Page 'compare.html'>
    """
    paths = _path_of("old", old), _path_of("new", new)
    with rename_arguments_in_errors():
        result = suite.compare(*paths, metrics=metrics, critical=threshold, tolerances=tolerances)
    values = {item.name: getattr(result, item.name) for item in fields(result)}
    return Comparison(**values, studies=paths)


def _path_of(name: str, study: Study | suite.SuiteResult | Path | str) -> Path:
    return study.study if isinstance(study, suite.SuiteResult) else check_path(name, study)
