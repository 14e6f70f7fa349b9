"""What the parameter space shows between its scenarios: predicted scores, and where little is known."""

from __future__ import annotations

import json

import numpy as np
import pytest

from browser.test_linked import drag, pictures
from conftest import at_night
from cornercase.evidence._score_surrogate import fit_surrogate
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.metrics import METRICS
from cornercase.report._predictor_payload import _encode_predictor
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.scenario._distributions import Distribution
from cornercase.study._objective import Objective

SPACES = {
    "choices": ParameterSpace(
        [
            Parameter("way", 0, 2, choices=("left", "right", "straight on")),
            Parameter("gap", 1.0, 4.0, 0.1),
            Parameter("speed", 5.0, 15.0, distribution=Distribution("normal", 5.0, 15.0, (10.0, 2.0))),
            Parameter("version", 0, 0, choices=("new",)),
        ]
    ),
    "ranges": ParameterSpace.from_ranges(["a=0:1", "b=-3:7:0.5", "c=2:2.5", "d=0:1"]),
}
GRID = """([told, parameters, scenario, x, xs, y, ys]) => {
  const predictor = new Predictor(told, parameters);
  const place = [scenario, x, xs, y, ys];
  return [predictor.scores(...place), predictor.deviations(...place)].map((each) => [...each]);
}"""
SURFACE = "() => cornercase.views.get('space').plot.surface"


def grid_values(parameter):
    if parameter.choices:
        return list(range(len(parameter.choices)))
    if parameter.step is not None:
        return [parameter.low + parameter.step * k for k in range(parameter.size or 0)][::5]
    return np.linspace(parameter.low, parameter.high, 7).tolist()


@pytest.mark.parametrize("name", at_night(sorted(SPACES), {"ranges"}))
@pytest.mark.parametrize(("metric", "count"), [("wttc", 40), ("traffic-quality", 500)])
def test_the_page_predicts_what_python_does(tab, reports, name, metric, count):
    space = SPACES[name]
    points = space.snap(np.random.default_rng(0).random((count, space.dimension)))
    encoded = encode_points(space, points)
    # Oriented: lower is more critical.
    scores = np.sin(3.0 * encoded).sum(axis=1) + encoded[:, 0] * encoded[:, 1]
    surrogate = fit_surrogate(space, points, scores).condense(192)
    objective = Objective([METRICS.create(metric)])
    sign = 1.0 if objective.lower_is_critical else -1.0
    told = json.loads(json.dumps(_encode_predictor(surrogate, objective)))
    parameters = [{"name": p.name, "low": p.low, "high": p.high, "choices": list(p.choices)} for p in space.parameters]
    page = tab.open(reports("one"))
    middle = {p.name: p.value_at(0.4) for p in space.parameters}
    scenario = [p.extract_number(middle) for p in space.parameters]
    for x, y in ((0, 1), (1, 2), (3, 0)):
        across, up = space.parameters[x], space.parameters[y]
        xs, ys = grid_values(across), grid_values(up)
        found = page.evaluate(GRID, [told, parameters, scenario, x, xs, y, ys])
        wanted = []
        for b in ys:
            for a in xs:
                values = [*scenario]
                values[x], values[y] = a, b
                named = [p.choices[int(v)] if p.choices else v for p, v in zip(space.parameters, values, strict=True)]
                wanted.append([p.unit_position(v) for p, v in zip(space.parameters, named, strict=True)])
        mean, deviation = surrogate.process.predict(encode_points(space, np.array(wanted)))
        scale = surrogate.deviation
        np.testing.assert_allclose(found[0], sign * (surrogate.mean + scale * mean), atol=2e-3 * scale)
        np.testing.assert_allclose(found[1], scale * deviation, atol=1e-2 * scale)


def test_it_is_drawn_below_the_points_and_kept_in_the_address(tab, reports):
    page = tab.open(reports("four"))
    before = pictures(page, "space")
    assert page.locator("#space-told").is_hidden()
    seen = [before["space"]]
    for mode in ("predicted", "unknown"):
        page.select_option("#space-surface", mode)
        tab.settle()
        seen.append(pictures(page, "space")["space"])
        assert (
            "of the variance of wttc, with each scenario left out in turn" in page.locator("#space-told").inner_text()
        )
        page.wait_for_function("(mode) => location.hash.includes(`surface=${mode}`)", arg=mode)
    assert len(set(seen)) == 3
    page.reload()
    page.wait_for_selector("html[data-ready]")
    tab.settle()
    assert page.input_value("#space-surface") == "unknown"
    assert pictures(page, "space")["space"] == seen[2]
    page.select_option("#space-surface", "off")
    tab.settle()
    assert pictures(page, "space") == before


def test_the_boundary_is_where_the_prediction_meets_the_threshold(tab, reports):
    page = tab.open(f"{reports('plain')}#surface=predicted")
    found = page.evaluate(
        f"""() => {{
          const surface = ({SURFACE})();
          const {{ plot, store }} = surface;
          const [x, y] = surface.axes;
          const {{ segments }} = surface.drawn.boundary;
          const scores = [];
          for (let k = 0; k < segments.length; k += 2) {{
            const place = [[plot.x.value(segments[k])], [plot.y.value(segments[k + 1])]];
            scores.push(predictorOf(store).scores(surface.values(), x, place[0], y, place[1])[0]);
          }}
          return [scores, surface.threshold, store.contents.predictor.scale];
        }}"""
    )
    scores, threshold, scale = found
    assert len(scores) > 10
    assert np.quantile(np.abs(np.array(scores) - threshold), 0.9) < 0.05 * abs(scale)


def test_others_are_as_in_the_selected_scenario(tab, reports):
    page = tab.open(f"{reports('four')}#surface=predicted&id=3")
    first = pictures(page, "space")["space"]
    assert "as in scenario 3" in page.locator("#space-told").inner_text()
    page.evaluate("() => cornercase.store.select(30)")
    tab.settle()
    assert "as in scenario 30" in page.locator("#space-told").inner_text()
    assert pictures(page, "space")["space"] != first


def test_a_brush_computes_nothing_again(tab, reports):
    page = tab.open(f"{reports('plain')}#surface=unknown")
    page.evaluate(f"() => {{ window.before = ({SURFACE})().made; }}")
    drag(page, (0.3, 0.2), (0.6, 0.7))
    tab.settle()
    assert page.evaluate("() => cornercase.store.ranges.size") == 2
    assert page.evaluate(f"() => ({SURFACE})().made === window.before && ({SURFACE})().drawn === window.before")


def test_axes_that_are_no_parameters_say_so(tab, reports):
    page = tab.open(f"{reports('plain')}#surface=predicted")
    page.select_option("#space-x", "score wttc")
    tab.settle()
    assert page.locator("#space-told").inner_text() == "For a prediction, choose two different parameters as axes."
    page.select_option("#space-x", "round")
    page.select_option("#space-y", "id")
    tab.settle()
    assert page.evaluate(f"() => ({SURFACE})().isDrawn") is False


def test_where_hardly_anything_is_predicted_nothing_is_drawn(tab, reports):
    page = tab.open(reports("plain"))
    page.evaluate(
        "() => cornercase.store.setContents({ ...cornercase.store.contents, predictor: null, predictor_missing: 'Hardly.' })"
    )
    tab.settle()
    before = pictures(page, "space")
    page.select_option("#space-surface", "predicted")
    tab.settle()
    assert page.locator("#space-told").inner_text() == "Hardly."
    assert pictures(page, "space") == before


@pytest.mark.parametrize("name", ["pareto", "one"])
def test_a_study_without_anything_to_predict_has_no_switch(tab, reports, name):
    page = tab.open(f"{reports(name)}#surface=predicted")
    assert page.locator("#space-surface").is_hidden()
    assert page.locator("#space-told").is_hidden()
