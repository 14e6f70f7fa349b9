"use strict";

// Entities whose values are shown.
const MOST_VALUES = 30;

// One of the two scenes of the replay: name and values of a scenario, its canvas, and the values at the clock's time.
class ReplayPane {
  constructor(slot, panel) {
    this.slot = slot;
    this.panel = panel;
    this.id = null;
    this.recording = null;
    this.trouble = null;
    this.asked = 0;
    this.box = newElement("div", "pane");
    this.title = newElement("h3", "pane-title");
    this.facts = newElement("p", "pane-facts");
    this.canvas = newElement("canvas", "scene");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-keyshortcuts", "Space ArrowLeft ArrowRight Home End + - 0");
    this.message = newElement("p", "pane-message");
    this.message.hidden = true;
    this.values = newElement("table", "pane-values");
    this.now = newElement("p", "pane-now");
    this.box.append(this.title, this.facts, this.message, this.canvas, this.now);
    this.values.hidden = true;
    this.box.hidden = true;
    moveByPointer(this.canvas, panel.camera);
    new ResizeObserver(() => panel.changed()).observe(this.canvas);
  }

  // Shows a scenario, or none; resolves when its recording, or the message that there is none, is shown.
  async show(id) {
    this.id = id;
    this.recording = null;
    this.trouble = null;
    this.lastBox = null;
    const asked = ++this.asked;
    this.box.hidden = id === null;
    this.values.hidden = true;
    if (id === null) {
      delete this.box.dataset.replay;
      delete this.box.dataset.scenario;
      delete this.box.dataset.time;
      return;
    }
    this.box.dataset.replay = this.slot;
    this.box.dataset.scenario = id;
    delete this.box.dataset.time;
    this.describe();
    let recording = null;
    let trouble = null;
    try {
      recording = await this.panel.recordings.get(id);
    } catch (error) {
      trouble = `The recording of scenario ${id} could not be read. ${error.message}`;
    }
    if (asked !== this.asked) return;
    this.recording = recording;
    this.trouble = trouble;
    if (recording) this.prepare(recording);
    this.say(recording ? "" : trouble ?? this.whyMissing(id));
  }

  prepare(recording) {
    const { ego, other } = this.panel.store.contents;
    this.ego = recording.names.indexOf(ego);
    this.others = [other].flat().map((name) => recording.names.indexOf(name)).filter((entity) => entity >= 0);
    this.fillValues();
  }

  // The main other entity: with several, the one the score belongs to.
  get other() {
    const { store } = this.panel;
    // An expected run is measured against the same one.
    const whom = store.against(this.panel.metric().name, store.rows.get(Math.abs(this.id)));
    return whom === null ? this.others[0] ?? -1 : this.recording.names.indexOf(whom);
  }

  describe() {
    const { store } = this.panel;
    const expected = store.contents.expected?.runs[-this.id];
    if (expected) {
      this.title.textContent = scenarioName(store, this.id);
      this.facts.textContent = unturned(expected.facts);
      return;
    }
    const row = store.rows.get(this.id);
    const { scenarios, parameters, outcomes, kept } = store.contents;
    this.title.textContent = scenarioName(store, this.id);
    const facts = [];
    const verdict = store.contents.verdicts?.[this.id];
    if (verdict) facts.push(`${verdict.state}: ${verdict.why}`, verdict.file);
    if (scenarios.outcome[row] !== null) facts.push(outcomes[scenarios.outcome[row]]);
    if (store.options.aspect !== null && store.kindOf(row) !== null) facts.push(store.kindName(store.kindOf(row)));
    if (scenarios.critical[row]) facts.push("critical");
    if (kept[this.id]) facts.push(`kept as ${kept[this.id].role}`);
    const values = parameters.map((one, k) => {
      const value = scenarios.values[k][row];
      return `${one.name} = ${one.choices.length ? one.choices[value] : withSceneUnit(value, one.unit)}`;
    });
    this.facts.textContent = unturned([...new Set(facts), ...values].filter(Boolean).join(" · "));
  }

  whyMissing(id) {
    const { store } = this.panel;
    const { study, scenarios, errors } = store.contents;
    if (scenarios.failed[store.rows.get(id)]) {
      return `${scenarioName(store, id)} failed, so there is nothing to replay: ${errors[id]}`;
    }
    const file = typeof shellWord === "function" ? shellWord(study) : study;
    return (
      `The recording of scenario ${id} is not in this file. See it with: cornercase replay ${file} ${id} -o run.html,` +
      ` or all of them with: cornercase watch ${file}`
    );
  }

  say(text) {
    this.message.textContent = text;
    this.message.hidden = !text;
    this.canvas.hidden = this.now.hidden = this.values.hidden = Boolean(text);
  }

  fillValues() {
    const { recording } = this;
    const head = newElement("thead");
    const row = newElement("tr");
    for (const name of ["entity", "speed [m/s]", "acceleration [m/s²]"]) {
      const cell = newElement("th", "", name);
      cell.scope = "col";
      row.append(cell);
    }
    head.append(row);
    const body = newElement("tbody");
    const order = recording.names.map((_, entity) => entity);
    const isThird = (entity) => entity !== this.ego && !this.others.includes(entity);
    order.sort((one, other) => isThird(one) - isThird(other));
    this.cells = new Map();
    for (const entity of order.slice(0, MOST_VALUES)) {
      const name = recording.names[entity];
      const line = newElement("tr");
      const first = newElement("th", "", name);
      first.scope = "row";
      first.dataset.role = entity === this.ego ? "ego" : isThird(entity) ? "third" : "other";
      const cells = [newElement("td"), newElement("td")];
      line.append(first, ...cells);
      body.append(line);
      this.cells.set(entity, cells);
    }
    if (order.length > MOST_VALUES) {
      const line = newElement("tr");
      line.append(newElement("td", "", `and ${order.length - MOST_VALUES} more`));
      body.append(line);
    }
    this.values.replaceChildren(newElement("caption", "", `${scenarioName(this.panel.store, this.id)} now`), head, body);
  }

  // The instant at which the metric's course is most critical, in s; else the first collision, else the start.
  criticalTime() {
    const { recording, panel } = this;
    const metric = panel.metric();
    const k = mostCriticalInstant(recording.courses[metric.name], metric.lower_is_critical);
    if (k !== null) return recording.time[k];
    return recording.collisions[0]?.[0] ?? recording.time[0];
  }

  // The times that the view is chosen by: from some seconds before the most critical instant to one after it.
  decisiveTimes(before) {
    const at = this.criticalTime();
    return [at - before, at + 1];
  }

  // The region around the ego in which both stay if they drive along together, at a fraction of the way that they go,
  // as on a motorway; else null.
  regionAlong() {
    if (this.ego < 0 || this.other < 0) return null;
    const near = regionOf(this.recording, [this.ego, this.other], ...this.decisiveTimes(3), 0);
    const around = regionAround(this.recording, this.ego, this.other, ...this.decisiveTimes(2), 6);
    if (!near || !around) return null;
    const [length, reach] = [near, around].map(([left, bottom, right, top]) => Math.max(right - left, top - bottom));
    return length > 40 && reach < 0.7 * length ? around : null;
  }

  // Positions of the two before the most critical instant, with a margin.
  region(all) {
    const { recording } = this;
    if (all) {
      const everyone = recording.names.map((_, k) => k);
      return regionOf(recording, everyone, -Infinity, Infinity, 8);
    }
    const both = [this.ego, this.other].filter((k) => k >= 0);
    const near = regionOf(recording, both, ...this.decisiveTimes(3), 6);
    return near ?? regionOf(recording, both, -Infinity, Infinity, 8) ?? this.region(true);
  }

  // The current or last position of the ego.
  boxOfEgo(time) {
    if (!this.recording || this.ego < 0) return null;
    this.lastBox = boxAt(this.recording, this.ego, this.timeOf(time)) ?? this.lastBox;
    return this.lastBox;
  }

  // Time within the recording: a recording that has ended stays at its end.
  timeOf(time) {
    const { time: times } = this.recording;
    return Math.min(Math.max(time, times[0]), times[times.length - 1]);
  }

  size() {
    return { width: this.canvas.clientWidth, height: this.canvas.clientHeight };
  }

  // Pixels of a point of the plane, from the canvas's upper left.
  toPixels(x, y) {
    const { width, height } = this.size();
    const view = this.panel.camera.view(this.boxOfEgo(this.panel.clock.time));
    return { x: width / 2 + (x - view.x) * view.scale, y: height / 2 - (y - view.y) * view.scale };
  }

  draw(time, colours) {
    if (!this.recording) return;
    const { width, height } = this.size();
    if (!width || !height) return;
    const own = this.timeOf(time);
    const ratio = window.devicePixelRatio || 1;
    const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== wide) this.canvas.width = wide;
    if (this.canvas.height !== high) this.canvas.height = high;
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const view = this.panel.camera.view(this.boxOfEgo(time));
    const { ego, other, others, recording } = this;
    const { road, sight } = this.panel;
    drawScene(context, { width, height, view, recording, time: own, ego, other, others, road, colours, sight });
    this.box.dataset.time = String(Number(own.toFixed(4)));
    this.tell(own);
  }

  tell(time) {
    const { recording, panel } = this;
    const boxes = boxesAt(recording, time);
    for (const [entity, [speed, acceleration]] of this.cells) {
      const box = boxes[entity];
      speed.textContent = box ? withSceneUnit(box.speed, "", 2) : "–";
      acceleration.textContent = box ? withSceneUnit(box.acceleration, "", 2) : "–";
    }
    const metric = panel.metric();
    const course = recording.courses[metric.name];
    const score = course ? between(course, momentOf(recording.time, time)) : NaN;
    const parts = [`${time.toFixed(2)} s`];
    if (course) parts.push(`${metric.name} ${courseText(score, metric)}`);
    const seen = this.ego >= 0 && this.other >= 0 ? sees(boxes, this.ego, this.other) : null;
    const [ego, other] = [recording.names[this.ego], recording.names[this.other]];
    if (seen !== null) parts.push(seen ? `${ego} can see ${other}` : `${other} is hidden from ${ego}`);
    if (time >= recording.time[recording.time.length - 1] - 1e-6) parts.push("end of the recording");
    this.now.textContent = parts.join(" · ");
    const said = `${scenarioName(panel.store, this.id)} from above at ${parts.join(", ")}`;
    if (!panel.clock.playing) this.canvas.setAttribute("aria-label", said);
  }
}

// At its cap, a course is only known to be not more critical than that, or it is undefined.
function courseText(score, { unit, cap, lower_is_critical: lower }) {
  if (!Number.isFinite(score)) return "–";
  const capped = lower ? score >= cap - 1e-4 : score <= cap + 1e-4;
  return capped ? `none or ${lower ? "above" : "below"} ${withSceneUnit(cap, unit)}` : withSceneUnit(score, unit);
}

// The name of a scenario: its id, or the page's own name if it shows several studies.
function scenarioName(store, id) {
  return ownName(store, id) ?? `Scenario ${id}`;
}

function ownName({ contents }, id) {
  return contents.called?.[id] ?? contents.expected?.runs[-id]?.called;
}

function newElement(tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

function withSceneUnit(value, unit, digits = null) {
  if (value === null || !Number.isFinite(value)) return "–";
  const text = digits === null ? String(Number(value.toPrecision(4))) : value.toFixed(digits);
  return unit && unit !== "1" ? `${text} ${unit}` : text;
}
