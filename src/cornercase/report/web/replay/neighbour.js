"use strict";

// A scenario to compare with: the nearest one in the parameter space with a different outcome. If outcomes
// are unknown, with a different kind; if kinds are unknown too, critical against not critical. If all are
// equal, simply the nearest.
function neighbourOf(store, id, has) {
  const { scenarios, parameters } = store.contents;
  const row = store.rows.get(id);
  if (row === undefined) return null;
  if (sameVerdict(store) !== null) return null;
  const verdictOf = (k) => store.contents.verdicts?.[scenarios.id[k]]?.state ?? null;
  const tests = [
    // Of a suite's run, one with another verdict.
    (k) => differs(verdictOf(k), verdictOf(row)),
    (k) => known(scenarios.outcome, k, row) && scenarios.outcome[k] !== scenarios.outcome[row],
    (k) => store.options.aspect !== null && differs(store.kindOf(k), store.kindOf(row)),
    (k) => scenarios.critical[k] !== scenarios.critical[row],
    () => true,
  ];
  const candidates = [];
  for (let k = 0; k < store.n; k++) {
    if (k !== row && !scenarios.failed[k] && has(scenarios.id[k])) candidates.push(k);
  }
  const away = (k) => {
    let sum = 0;
    parameters.forEach((one, j) => {
      const step = scenarios.values[j][k] - scenarios.values[j][row];
      if (one.choices.length) sum += step === 0 ? 0 : 1;
      else if (one.high > one.low) sum += (step / (one.high - one.low)) ** 2;
    });
    return sum;
  };
  for (const test of tests) {
    const found = candidates.filter(test);
    if (!found.length) continue;
    const ways = new Map(found.map((k) => [k, away(k)]));
    return scenarios.id[found.reduce((best, k) => (ways.get(k) < ways.get(best) ? k : best))];
  }
  return null;
}

// The verdict of all scenarios of a suite's run that ran, if it is the same; else null.
function sameVerdict(store) {
  const { verdicts, scenarios } = store.contents;
  const states = new Set();
  for (let k = 0; k < store.n; k++) {
    const state = verdicts?.[scenarios.id[k]]?.state;
    if (!scenarios.failed[k]) states.add(state ?? null);
  }
  const [state] = states;
  return states.size === 1 && state !== null ? state : null;
}

function known(column, ...rows) {
  return rows.every((row) => column[row] !== null && column[row] !== undefined);
}

function differs(one, other) {
  return one !== null && other !== null && one !== other;
}

// The first scenario of the page: the most critical one by the shown metric.
function mostCriticalScenario(store) {
  const { scenarios, metrics } = store.contents;
  const metric = metrics.find((one) => one.name === store.options.metric) ?? metrics[0];
  // A live page knows it only after an analysis.
  const stored = store.contents.most_critical?.[metric.name];
  if (store.rows.has(stored)) return stored;
  const scores = scenarios.scores[metric.name];
  let best = null;
  for (let row = 0; row < store.n; row++) {
    const score = scores[row];
    if (score === null || scenarios.failed[row]) continue;
    const gain = best === null ? 1 : metric.lower_is_critical ? scores[best] - score : score - scores[best];
    const better = gain > 0 || (gain === 0 && scenarios.collides[row] > scenarios.collides[best]);
    if (better) best = row;
  }
  return best === null ? null : scenarios.id[best];
}
