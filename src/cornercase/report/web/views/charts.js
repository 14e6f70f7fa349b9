"use strict";

// Charts without brushes. Colours of kinds are for kinds only: curves are in the colours of text, comparisons in grey, and
// what is critical in red. They are drawn by Plotly, which is unpacked when the first of them becomes visible.

// Plotly interprets some HTML in its texts; names must stay plain.
function plainText(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

function chartLayout(more) {
  const { text, faint, grid, line: edge, font, raised } = themeColours();
  const axis = { gridcolor: grid, linecolor: edge, zerolinecolor: grid, tickfont: { color: faint }, automargin: true };
  const layout = {
    font: { family: font, size: 12, color: text },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 56, r: 14, t: 30, b: 44 },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { size: 12 } },
    hoverlabel: { bgcolor: raised, bordercolor: edge, font: { color: text } },
    hovermode: "closest",
    uirevision: "kept",
    ...more,
  };
  for (const name of Object.keys(layout)) {
    if (/^[xy]axis/.test(name)) layout[name] = { ...axis, ...layout[name] };
  }
  return layout;
}

// A Plotly view: `fill(store)` returns traces, layout, and a sentence with the same content.
function chartView({ fill, height = 330, events: more = [], ...view }) {
  return {
    ...view,
    heavy: true,
    create(box, store) {
      const place = document.createElement("div");
      place.className = "plotly-box";
      place.style.height = `${height}px`;
      place.setAttribute("role", "img");
      place.tabIndex = 0;
      box.append(place);
      const draw = () => {
        const { traces, layout, label } = fill(store);
        place.setAttribute("aria-label", label);
        loadPlotly().then((Plotly) =>
          Plotly.react(place, traces, chartLayout(layout), { displayModeBar: false, responsive: true }));
      };
      return {
        redraw(events) {
          if (["contents", "theme", ...more].some((one) => events.has(one))) draw();
        },
      };
    },
  };
}

// An interval around values in Plotly's form.
function intervalBars(values, intervals, colour) {
  return {
    type: "data",
    symmetric: false,
    color: colour,
    thickness: 1.4,
    width: 3,
    array: intervals.map(([, high], k) => Math.max(0, high - values[k])),
    arrayminus: intervals.map(([low], k) => Math.max(0, values[k] - low)),
  };
}

function steps(x, y, name, colour, k) {
  return {
    type: "scatter",
    mode: "lines",
    x,
    y,
    name,
    yaxis: k ? `y${k + 1}` : "y",
    line: { shape: "hv", width: 2, color: colour, dash: PLOTLY_DASHES[k] },
    hovertemplate: `%{y:.4g} after %{x} scenarios<extra>${name}</extra>`,
  };
}

function missedTrace(missed, k) {
  const values = missed.map((one) => 100 * one.value);
  return {
    type: "scatter",
    mode: "lines+markers",
    name: "missed share of the critical set",
    yaxis: k ? `y${k + 1}` : "y",
    x: missed.map((one) => one.run),
    y: values,
    line: { color: themeColours().danger, dash: "dot" },
    marker: { symbol: "diamond", size: 7 },
    error_y: intervalBars(values, missed.map(({ value, low, high }) => [100 * (low ?? value), 100 * (high ?? value)]), themeColours().faint),
    hovertemplate: "%{y:.3g} % after %{x} scenarios<extra>missed</extra>",
  };
}

// Panels above each other with a common axis of scenarios.
VIEWS.push(chartView({
  name: "search",
  title: "Search over time",
  about: "Found after each number of scenarios.",
  known: true,
  finding: true,
  wanted: (store) => (store.contents.search?.run.length ?? 0) > 1,
  height: 420,
  fill(store) {
    const { run, best, critical, missed, metric, unit } = store.contents.search;
    const traces = [];
    const titles = [];
    const add = (trace, title) => {
      traces.push(trace(traces.length));
      titles.push(title);
    };
    const { text, danger } = themeColours();
    const searched = `${plainText(metric ?? store.contents.searched)} [${plainText(unit || "1")}]`;
    if (best) add((k) => steps(run, best, "best score so far", text, k), searched);
    if (critical?.some((one) => one)) {
      add((k) => steps(run, critical, "critical scenarios found", danger, k), "found [1]");
    }
    if (missed?.length) add((k) => missedTrace(missed, k), "missed [%]");
    const count = traces.length;
    const xaxis = { title: { text: "scenarios that were run [1]" }, anchor: count > 1 ? `y${count}` : "y" };
    const layout = { xaxis };
    titles.forEach((title, k) => {
      const high = 1 - k / count;
      const domain = [high - 1 / count + (k < count - 1 ? 0.06 : 0), high];
      layout[k ? `yaxis${k + 1}` : "yaxis"] = { title: { text: title }, domain, rangemode: "tozero" };
    });
    const last = run.length - 1;
    const parts = [`Search over time: after ${run[last]} scenarios`];
    if (best) parts.push(`the best score is ${formatNumber(best[last])}`);
    if (critical?.length) parts.push(`${critical[last]} critical ones were found`);
    return { traces, layout, label: parts.join(", ") };
  },
}));

VIEWS.push(chartView({
  name: "matters",
  title: "What matters",
  about: "Shares of the score's variance.",
  more: "The share that each parameter explains, alone and with all others; lines are 90 % intervals.",
  known: true,
  wanted: (store) => Boolean(store.contents.sensitivity?.names.length),
  fill(store) {
    const { sensitivity } = store.contents;
    const { names, first, total } = sensitivity;
    const { text, faint, muted } = themeColours();
    const bars = (values, intervals, name, colour, shape) => ({
      type: "bar",
      orientation: "h",
      name,
      x: values,
      y: names.map((one) => plainText(shortened(one, 30))),
      marker: { color: colour, pattern: { shape } },
      error_x: intervalBars(values, intervals, text),
      hovertemplate: `%{y}: %{x:.2f}<extra>${name}</extra>`,
    });
    const traces = [
      bars(total, sensitivity.total_interval, "with all others (total)", faint, ""),
      bars(first, sensitivity.first_interval, "alone (first order)", muted, "/"),
    ];
    const layout = {
      barmode: "group",
      xaxis: { title: { text: "share of the variance [1]" }, range: [0, 1] },
      yaxis: { autorange: "reversed" },
    };
    const said = names.map((name, k) => `${name} ${total[k].toFixed(2)}`).join(", ");
    return { traces, layout, label: `Share of the variance that each parameter explains with all others: ${said}` };
  },
}));

function coveredAspect(store) {
  const all = store.contents.coverage;
  return Object.hasOwn(all, store.options.aspect) ? store.options.aspect : Object.keys(all)[0];
}

VIEWS.push(chartView({
  name: "coverage",
  title: "What the kept scenarios cover",
  about: "How many have a kept one near.",
  more: (store) =>
    `Scenarios that have a kept one within a distance by ${coveredAspect(store)}; for comparison, other choices of as many.`,
  known: true,
  wanted: (store) => Object.keys(store.contents.coverage ?? {}).length > 0,
  events: ["options"],
  fill(store) {
    const all = store.contents.coverage;
    const name = coveredAspect(store);
    const { unit, reach, kept, medoids, random_low: low, random_high: high, critical } = all[name];
    const { text: ink, muted, danger } = themeColours();
    const curve = (y, text, colour, dash) => ({
      type: "scatter",
      mode: "lines",
      x: reach,
      y,
      name: text,
      line: { color: colour, dash, width: 2.2 },
      hovertemplate: `%{y:.0f} % within %{x:.3g}<extra>${text}</extra>`,
    });
    const edge = (y) => ({ type: "scatter", mode: "lines", x: reach, y, line: { width: 0 }, hoverinfo: "skip" });
    const band = { fill: "tonexty", fillcolor: "rgba(140,140,140,0.3)", name: "random choices, 90 %" };
    const traces = [
      { ...edge(low), showlegend: false },
      { ...edge(high), ...band },
      curve(medoids, "k-medoids", muted, "dot"),
      curve(kept, "kept", ink, "solid"),
    ];
    if (critical) traces.push(curve(critical, "kept, of the critical ones", danger, "dash"));
    const title = { text: `distance to a kept one [${plainText(unit)}]` };
    const layout = { xaxis: { title }, yaxis: { title: { text: "scenarios [%]" }, range: [0, 103] } };
    const most = reach[kept.findIndex((one) => one >= 90)];
    const said = most === undefined ? "" : `: 90 % of the scenarios have a kept one within ${formatNumber(most)}`;
    return { traces, layout, label: `Coverage by ${name}${said}` };
  },
}));
