"""What is known of a study that is followed: the sentences, kinds and tables of its page, found in the background."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase.report.answers import tell_about
from cornercase.report.contents import knowledge_part, scenario_part
from cornercase.report.data import read_report_data
from cornercase.report.details import page_details
from cornercase.report.live.follower import Follower
from cornercase.report.live.surroundings import Surroundings
from cornercase.report.sections.overview import tell_provenance
from cornercase.study import Study

# s between two findings, and how many times as long as finding took.
_LEAST: Final = 3.0
_TIMES: Final = 4.0
# s between two looks at whether anything has changed.
_PAUSE: Final = 0.25
# What a browser has to ask for again with everything where it changed.
_COLUMNS: Final = ("kinds", "kept", "outcomes", "roads", "rerun", "default_aspect")


@dataclass(frozen=True)
class Knowledge:
    """What is known of a study at a moment.

    Attributes
    ----------
    epoch : str
        Which study, as `Follower.epoch`; empty for none.
    number : int
        Grows with each that differs from the one before.
    layout : int
        Grows with each whose kinds, outcomes or kept scenarios differ from those before.
    parts : dict of str to object
        As `cornercase.report.contents.knowledge_part`, with the HTML of the tables; empty before anything is known.
    outcomes : dict of int to str
        How scenarios ended, by id.
    """

    epoch: str = ""
    number: int = 0
    layout: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    outcomes: dict[int, str] = field(default_factory=dict)

    def of(self, epoch: str) -> Knowledge:
        """Give what is known of a study.

        Parameters
        ----------
        epoch : str
            Which study, as `Follower.epoch`.

        Returns
        -------
        Knowledge
            Empty where this is of another one.
        """
        return self if self.epoch == epoch else Knowledge(epoch, self.number, self.layout)


class Finder:
    """Finds what is known, in a thread of its own, as often as the study changes but never most of the time.

    Parameters
    ----------
    follower : Follower
        Knows when the study has changed.
    scenario : Path or None, default None
        Scenario that was explored; None where it is looked for.

    Attributes
    ----------
    known : Knowledge
        By now, never of more scenarios than the follower knows.
    """

    def __init__(self, follower: Follower, scenario: Path | None = None) -> None:
        self.known = Knowledge()
        self._follower = follower
        self._surroundings = Surroundings(scenario)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._find_always, name="finder of knowledge", daemon=True)

    def start(self) -> None:
        """Begin to find."""
        self._thread.start()

    def stop(self) -> None:
        """Find no more; what is being found is not waited for."""
        self._end.set()

    def _find_always(self) -> None:
        seen: tuple[str, int] | None = None
        while not self._end.wait(_PAUSE):
            now = (self._follower.epoch, self._follower.changes)
            if now == seen or not self._follower.state.run:
                continue
            begun = time.monotonic()
            # What cannot be read now may be whole the next time.
            with suppress(InputError):
                found = _find(self._follower.path, self._surroundings)
                if found is not None and self._is_followed(now[0], found[0]["known_of"]):
                    self._take(now[0], *found)
            seen = now
            self._end.wait(max(_LEAST, _TIMES * (time.monotonic() - begun)))

    def _is_followed(self, epoch: str, count: int) -> bool:
        """Wait until the follower knows as many scenarios; False where it never will."""
        while self._follower.epoch == epoch and not self._end.is_set():
            if self._follower.state.ended >= count:
                return True
            self._end.wait(_PAUSE)
        return False

    def _take(self, epoch: str, parts: dict[str, Any], outcomes: dict[int, str]) -> None:
        old = self.known
        same = (
            old.epoch == epoch
            and old.outcomes == outcomes
            and all(old.parts.get(name) == parts[name] for name in _COLUMNS)
        )
        if not same or old.parts != parts:
            self.known = Knowledge(epoch, old.number + 1, old.layout + (not same), parts, outcomes)


def _by_id(kinds: dict[str, Any], ids: list[int]) -> dict[str, Any]:
    """Clusters by the ids of their scenarios, as there may be more rows by the time that somebody asks."""
    known = [k for k, label in enumerate(kinds["labels"]) if label is not None]
    return kinds | {
        "labels": {ids[k]: kinds["labels"][k] for k in known},
        "embedding": [{ids[k]: column[k] for k in known} for column in kinds["embedding"]],
    }


def _find(path: Path, surroundings: Surroundings) -> tuple[dict[str, Any], dict[int, str]] | None:
    # The explorer writes on; the log that it writes to grows meanwhile, and is taken up after it.
    with Study.open(path, readonly=True) as study, study.snapshot():
        if not study.done():
            return None
        data = read_report_data(study)
        around = surroundings.of(study, data)
    parts, scenarios = knowledge_part(data) | around, scenario_part(data)
    ids, named = scenarios["scenarios"]["id"], scenarios["outcomes"]
    places = zip(ids, scenarios["scenarios"]["outcome"], strict=True)
    outcomes = {scenario: named[place] for scenario, place in places if place is not None}
    parts["kinds"] = {name: _by_id(one, ids) for name, one in parts["kinds"].items()}
    parts["outcomes"] = named
    parts["known_of"] = len(ids)
    # The page counts its scenarios itself, as they come.
    parts["about"] = tell_about(data, counts=False)
    parts["details"] = [{"name": one.name, "title": one.title, "html": str(one.html)} for one in page_details(data)]
    parts["provenance"] = str(tell_provenance(data.study, data.summary))
    return parts, outcomes
