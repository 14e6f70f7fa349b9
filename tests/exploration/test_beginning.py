"""An exploration that cannot start leaves no file that would block the corrected command."""

from __future__ import annotations

import pytest

from conftest import car, scenario_file, teleport
from cornercase._common.errors import InputError, SimulationError
from cornercase.exploration import explore
from cornercase.scenario import ParameterSpace
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.synthetic_study import Synthetic, about, explorer


def roads(folder, road, *, own="1"):
    init = teleport("$s").replace('roadId="1"', f'roadId="{road}"')
    parameters = f"""<ParameterDeclaration name="s" parameterType="double" value="5"/>
<ParameterDeclaration name="road" parameterType="string" value="{own}"/>"""
    return scenario_file(
        folder,
        init=f'<Private entityRef="Ego">{init}</Private><Private entityRef="Other">{teleport("50")}</Private>',
        parameters=parameters,
        entities=car("Ego") + car("Other"),
    )


def explored(path, study, *ranges, **options):
    given = {"ego": "Ego", "other": "Other", "metrics": ["distance"], "optimizer": "random", "budget": 12, "batch": 6}
    return explore(path, study, ranges=ranges or ["s=0:100"], **{"duration": 0.5, **given, **options})


@pytest.mark.parametrize("workers", [1, 2])
def test_what_no_scenario_can_be_run_with_is_said_before_there_is_a_study(tmp_path, workers):
    study = tmp_path / "study.db"
    with pytest.raises(InputError, match="has no road '9'"):
        explored(roads(tmp_path, "9"), study, workers=workers)
    # None of the values can be used.
    with pytest.raises(InputError, match=r"has no road '[789]'"):
        explored(roads(tmp_path, "$road"), study, "road=7:9:1", "s=0:100", workers=workers)
    assert list(tmp_path.glob("study.db*")) == []


def test_an_unusable_choice_fails_its_scenarios_and_no_others(tmp_path):
    result = explored(roads(tmp_path, "$road", own="9"), tmp_path / "study.db", "road=1:2:1", "s=0:100")
    assert (result.done, result.failed) != (12, 0)
    assert result.done > 0
    with StudyFile.open(tmp_path / "study.db", readonly=True) as study:
        assert {row.values["road"] for row in study.finished_rows()} == {"1"}
        assert {(row.values["road"], row.error) for row in study.failed_rows()} == {("2", study.failed_rows()[0].error)}
        assert "has no road '2'" in str(study.failed_rows()[0].error)


def test_a_study_in_which_nothing_has_ended_takes_the_corrected_command(tmp_path, monkeypatch):
    path, study = roads(tmp_path, "1"), tmp_path / "study.db"

    def fails(self, concretes):
        yield SimulationError("lost")
        raise InputError("The simulator is out of order.")

    with monkeypatch.context() as broken:
        broken.setattr(Builtin, "run", fails)
        with pytest.raises(InputError, match="out of order"):
            explored(path, study, duration=0.5)
    assert explored(path, study, duration=1.0).done == 12
    # Now it is one of these settings.
    with pytest.raises(InputError, match="other simulator settings"):
        explored(path, study, duration=0.5)


def test_what_had_failed_before_is_kept_where_a_later_command_cannot_go_on(tmp_path, monkeypatch):
    path, study = roads(tmp_path, "1"), tmp_path / "study.db"

    def fails(self, concretes):
        for _ in concretes:
            yield SimulationError("lost")

    def ends(self, concretes):
        yield SimulationError("lost")
        raise InputError("The disk is full.")

    with monkeypatch.context() as broken:
        broken.setattr(Builtin, "run", fails)
        assert explored(path, study).failed == 12
        broken.setattr(Builtin, "run", ends)
        with pytest.raises(InputError, match="disk is full"):
            explored(path, study, budget=16, retry_failed=True)
    with StudyFile.open(study) as kept:
        assert len(kept.rows()) >= 12
    assert explored(path, study, budget=16).done + explored(path, study, budget=16).failed == 16


def test_a_study_with_a_result_stays_what_it_is(tmp_path):
    space = ParameterSpace.from_ranges(["a=0:1:0.01", "b=0:1"])
    with StudyFile.create(tmp_path / "study.db", about(space, "distance")) as study:
        explorer(study, Synthetic(), budget=3, batch=3).run()
        before = study.rows()
        with pytest.raises(InputError, match="another ego"):
            study.writer.check_and_update_meta(about(space, "distance", ego="C"))
        assert [row.id for row in study.rows()] == [row.id for row in before]
