"use strict";

// Scenarios in the plane of two columns that the reader picks.
class SpacePlot extends PointPlot {
  constructor(box, store, columns) {
    super(box, store, { name: "space" });
    this.columns = columns;
    this.surface = new Surface(this);
  }

  title() {
    const [x, y] = this.columns().map((column) => this.store.axis(column).title);
    return `Scenarios by ${x} and ${y}`;
  }

  summary() {
    return [super.summary(), this.surface.isDrawn ? this.surface.tell() : ""].filter(Boolean).join(". ");
  }

  drawBase(g) {
    const { store } = this;
    const [xName, yName] = this.columns();
    const [x, y] = [store.column(xName), store.column(yName)];
    const [xAxis, yAxis] = [store.axis(xName), store.axis(yName)];
    this.scaleX(...columnRange(store, xName), xAxis.choices);
    this.scaleY(...columnRange(store, yName), yAxis.choices);
    this.surface.draw(g);
    this.drawAxes(g, xAxis.title, yAxis.title);
    drawThreshold(g, this, xName, yName);
    if (this.hulls) this.drawHulls(g, x, y);
    this.drawPoints(g, x.map((value) => this.x.at(value)), y.map((value) => this.y.at(value)));
    this.surface.drawLabels(g);
  }

  // Edges of the hulls on which the archetypes were found.
  drawHulls(g, x, y) {
    const { store } = this;
    g.lineWidth = 0.8;
    g.globalAlpha = 0.5;
    for (const [label, edges] of Object.entries(store.contents.hulls)) {
      g.strokeStyle = kindColour(Number(label));
      for (const pair of edges) {
        const [one, other] = pair.map((id) => store.rows.get(id));
        line(g, this.x.at(x[one]), this.y.at(y[one]), this.x.at(x[other]), this.y.at(y[other]));
      }
    }
    g.globalAlpha = 1;
  }

  drawOver(g) {
    this.drawBrush(g);
    this.drawMarks(g);
  }

  drawBrush(g) {
    const [xName, yName] = this.columns();
    const [x, y] = [this.store.ranges.get(xName), this.store.ranges.get(yName)];
    if (!x && !y) return;
    const clip = (scale, range, least, most) =>
      (range ?? [-Infinity, Infinity]).map((value) =>
        Number.isFinite(value) ? Math.max(least, Math.min(most, scale.at(value))) : null);
    const [left, right] = clip(this.x, x, this.left, this.width - this.right);
    const [low, high] = clip(this.y, y, this.top, this.height - this.bottom);
    const [end, floor] = [this.width - this.right, this.height - this.bottom];
    const box = [left ?? this.left, high ?? this.top, right ?? end, low ?? floor];
    g.fillStyle = themeColours().accent;
    g.globalAlpha = 0.07;
    g.fillRect(box[0], box[1], box[2] - box[0], box[3] - box[1]);
    g.globalAlpha = 1;
    g.strokeStyle = themeColours().accent;
    g.lineWidth = 1.2;
    g.strokeRect(box[0], box[1], box[2] - box[0], box[3] - box[1]);
  }

  brushTo([x0, y0], [x1, y1]) {
    const [xName, yName] = this.columns();
    const xs = [this.x.value(x0), this.x.value(x1)].sort((one, other) => one - other);
    const ys = [this.y.value(y0), this.y.value(y1)].sort((one, other) => one - other);
    this.store.setRanges(xName === yName ? [[xName, ...xs]] : [[xName, ...xs], [yName, ...ys]]);
  }

  clearBrush() {
    const names = this.columns().filter((name) => this.store.ranges.has(name));
    if (names.length) this.store.setRanges(names.map((name) => [name, null, null]));
  }
}

// From minimum to maximum; for a parameter from bound to bound.
function columnRange(store, name) {
  const [kind, key] = Store.split(name);
  const [low, high] = finiteRange(store.column(name));
  if (kind !== "parameter") return [low, high];
  const one = store.contents.parameters.find((each) => each.name === key);
  return [Math.min(low, one.low ?? low), Math.max(high, one.high ?? high)];
}

// A line at the threshold, on an axis that shows the score.
function drawThreshold(g, plot, xName, yName) {
  const { store } = plot;
  g.strokeStyle = themeColours().danger;
  g.lineWidth = 1.2;
  g.setLineDash([5, 4]);
  for (const [name, scale, across] of [[xName, plot.x, true], [yName, plot.y, false]]) {
    const [kind, key] = Store.split(name ?? "");
    const threshold = kind === "score" ? store.threshold(key) : null;
    if (threshold === null || threshold < scale.low || threshold > scale.high) continue;
    const at = Math.round(scale.at(threshold)) + 0.5;
    if (across) line(g, at, plot.top, at, plot.height - plot.bottom);
    else line(g, plot.left, at, plot.width - plot.right, at);
  }
  g.setLineDash([]);
}

function allColumns(store) {
  const { metrics, parameters } = store.contents;
  return [
    ...parameters.map((one) => `parameter ${one.name}`),
    ...metrics.map((one) => `score ${one.name}`),
    "id",
    "round",
  ];
}

// The two most influential parameters; with one parameter, the score over it.
function firstColumns(store) {
  const { parameters, metrics, influential } = store.contents;
  const names = (influential ?? []).slice(0, 2).map((k) => `parameter ${parameters[k].name}`);
  return names.length > 1 ? names : [names[0] ?? "id", `score ${metrics[0].name}`];
}

function hasHulls(store, columns) {
  const { hulls, reduced_by: aspect } = store.contents;
  const parameters = columns.every((name) => name.startsWith("parameter "));
  return parameters && Object.keys(hulls ?? {}).length > 0 && (!aspect || aspect === store.options.aspect);
}

function canPredict(store) {
  return Boolean(store.contents.predictor || store.contents.predictor_missing);
}

function surfaceSelect(box, store) {
  const select = labelledSelect(box, "Between scenarios", "space-surface");
  select.title = "Predicted: the score in between, by a Gaussian process of all scenarios that were searched. " +
    "Unknown: its standard deviation, grey where no scenario is near; striped where it is open whether scenarios are critical.";
  setOptions(select, [["off", "nothing"], ["predicted", "predicted score"], ["unknown", "what is unknown"]]);
  select.addEventListener("change", () => store.set({ surface: select.value }));
  return select;
}

function hullBox(box, changed) {
  const label = document.createElement("label");
  label.className = "check";
  const check = document.createElement("input");
  check.type = "checkbox";
  check.id = "space-hulls";
  check.addEventListener("change", changed);
  label.append(check, "Hulls");
  box.append(label);
  return check;
}

VIEWS.push({
  name: "space",
  title: "Parameter space",
  about: "Each point is a scenario.",
  more: "Each point is a concrete scenario. Drag to keep a part of the space; click to see a scenario move.",
  finding: true,
  wanted: () => true,
  create(box, store) {
    const columns = () => {
      const [x, y] = firstColumns(store);
      return [store.options.x ?? x, store.options.y ?? y];
    };
    const options = document.createElement("div");
    options.className = "options";
    box.append(options);
    const selects = ["x", "y"].map((axis, k) => {
      const select = labelledSelect(options, axis === "x" ? "Across" : "Upwards", `space-${axis}`);
      setOptions(select, allColumns(store).map((name) => [name, columnName(name)]), columns()[k]);
      select.addEventListener("change", () => store.set({ [axis]: select.value }));
      return select;
    });
    const plot = new SpacePlot(box, store, columns);
    const surface = surfaceSelect(options, store);
    const hulls = hullBox(options, () => {
      plot.hulls = hulls.checked;
      plot.redraw(new Set(["options"]));
    });
    const legend = document.createElement("ul");
    legend.className = "legend";
    const shades = document.createElement("ul");
    shades.className = "legend";
    const told = document.createElement("p");
    told.className = "note";
    told.id = "space-told";
    box.append(legend, shades, told);
    const menu = rangeMenu(box, store, columns);
    return {
      plot,
      redraw(events) {
        hulls.parentElement.hidden = !hasHulls(store, columns());
        plot.hulls = hulls.checked && !hulls.parentElement.hidden;
        const { surface: shading } = plot;
        // The selected scenario says where the other parameters are.
        const isMoved = events.has("selected") && shading.isDrawn;
        plot.redraw(isMoved ? new Set([...events, "options"]) : events);
        if (onlyMarks(events) && !isMoved) return;
        surface.parentElement.hidden = !canPredict(store);
        surface.value = store.options.surface;
        shading.fillLegend(shades);
        told.textContent = canPredict(store) ? shading.tell() : "";
        told.hidden = !told.textContent;
        columns().forEach((name, k) => (selects[k].value = name));
        fillLegend(legend, store);
        menu();
      },
    };
  },
});
