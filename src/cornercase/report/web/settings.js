"use strict";

// The page of the settings: a map over gamma and eps, and the clusters of the setting that is taken.

const SVG = "http://www.w3.org/2000/svg";
const NOISE = 255;
const PICTURE = { width: 420, height: 340, left: 52, right: 10, top: 8, bottom: 42 };
// Paths of the symbols of colours.js, around 0 with a radius of about 4.
const MARKS = {
  circle: "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0z",
  square: "M-3.6-3.6h7.2v7.2h-7.2z",
  triangle: "M0-4.8L4.4 3.2h-8.8z",
  diamond: "M0-5L4.4 0L0 5L-4.4 0z",
  down: "M0 4.8L4.4-3.2h-8.8z",
  plus: "M-1.5-4.5h3v3h3v3h-3v3h-3v-3h-3v-3h3z",
  star: "M0-5L1.4-1.6L5-1.5L2.2.8L3.1 4.4L0 2.4L-3.1 4.4L-2.2.8L-5-1.5L-1.4-1.6z",
  pentagon: "M0-4.8L4.6-1.5L2.8 3.9h-5.6L-4.6-1.5z",
  ring: "M-3-3L3 3M-3 3L3-3",
};

function element(name, parts = {}, ...children) {
  const made = document.createElement(name);
  Object.assign(made, parts);
  made.append(...children);
  return made;
}

function drawn(name, attributes, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

function bytesOf(text) {
  return Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
}

function withUnit(name, unit) {
  return unit && unit !== "1" ? `${name} [${unit}]` : name;
}

function squared(unit) {
  return /^[a-zµ]+$/i.test(unit) ? `${unit}²` : `(${unit})²`;
}

function shortNumber(value) {
  if (value === null) return "–";
  return value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(3)));
}

// One aspect: its grid of settings, and the one that is taken; no cell is the setting stored in the study.
class Aspect {
  constructor(contents) {
    Object.assign(this, { contents, points: contents.usual, cell: null });
    this.labels = bytesOf(contents.labels);
    this.stored = this.storedCell();
    if (this.stored) this.cell = { gamma: this.stored.gamma, eps: this.stored.eps };
  }

  // Where the study's own setting is in the grid, if it is there.
  storedCell() {
    const { chosen, gammas, eps, min_samples } = this.contents;
    const at = { gamma: gammas.indexOf(chosen.gamma), eps: eps.indexOf(chosen.eps) };
    const points = min_samples.indexOf(chosen.min_samples);
    return at.gamma < 0 || at.eps < 0 || points < 0 ? null : { ...at, points };
  }

  index(gamma, eps) {
    const { gammas, eps: radii } = this.contents;
    return (this.points * gammas.length + gamma) * radii.length + eps;
  }

  value(key, gamma, eps) {
    return this.contents.scores.find((one) => one.key === key).values[this.index(gamma, eps)];
  }

  // Cluster of each scenario; the picture of the kernel space; the settings.
  taken() {
    const { contents, cell } = this;
    if (cell === null) {
      const { chosen } = contents;
      return { ...chosen, labels: bytesOf(chosen.labels), isStored: true };
    }
    const n = contents.rows.length;
    const at = contents.which[this.index(cell.gamma, cell.eps)];
    return {
      labels: this.labels.subarray(at * n, (at + 1) * n),
      embedding: contents.embeddings[cell.gamma],
      gamma: contents.gammas[cell.gamma],
      eps: contents.eps[cell.eps],
      min_samples: contents.min_samples[this.points],
      isStored: false,
    };
  }
}

class SettingsPage {
  constructor(contents) {
    this.contents = contents;
    this.aspects = contents.aspects.map((one) => new Aspect(one));
    this.aspect = this.aspects[0];
    this.shown = "clusters";
    this.axes = this.firstAxes();
    this.makeControls();
    this.makeAxes();
    document.getElementById("copy").addEventListener("click", async () => {
      document.getElementById("copied").textContent = await copyText(this.command(), "The command");
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      forgetColours();
      this.draw();
    });
    this.makeGrid();
    this.draw();
  }

  // Parameters that vary, numbers before choices.
  firstAxes() {
    const { parameters } = this.contents;
    const varied = parameters.map((one, k) => k).filter((k) => new Set(this.contents.scenarios.values[k]).size > 1);
    varied.sort((a, b) => parameters[a].choices.length - parameters[b].choices.length || a - b);
    return [varied[0] ?? 0, varied[1] ?? varied[0] ?? 0];
  }

  makeControls() {
    const box = document.getElementById("controls");
    const select = (id, title, names, change) => {
      const list = element("select", { id }, ...names.map((name, k) => element("option", { value: k, textContent: name })));
      list.addEventListener("change", () => change(Number(list.value)));
      box.append(element("label", { className: "control" }, element("span", { textContent: title }), list));
      return list;
    };
    select("aspect", "Compared by", this.aspects.map((one) => one.contents.name), (k) => {
      this.aspect = this.aspects[k];
      this.points.replaceChildren(...this.pointsOptions());
      this.points.value = this.aspect.points;
      this.makeGrid();
      this.draw();
    });
    select("shown", "The map shows", this.aspect.contents.scores.map((one) => one.title), (k) => {
      this.shown = this.aspect.contents.scores[k].key;
      this.draw();
    });
    this.points = select("points", "Min. points", [], (k) => {
      this.aspect.points = k;
      this.draw();
    });
    this.points.append(...this.pointsOptions());
    this.points.value = this.aspect.points;
    const own = element("button", { type: "button", id: "own", textContent: "Setting of the study" });
    own.addEventListener("click", () => this.take(null));
    box.append(own);
  }

  pointsOptions() {
    return this.aspect.contents.min_samples.map((one, k) => element("option", { value: k, textContent: one }));
  }

  makeAxes() {
    const { parameters } = this.contents;
    for (const [k, title] of ["Across", "Up"].entries()) {
      const options = parameters.map((one, at) => element("option", { value: at, textContent: one.name }));
      const list = element("select", { id: k ? "up" : "across" }, ...options);
      list.value = this.axes[k];
      list.addEventListener("change", () => {
        this.axes[k] = Number(list.value);
        this.draw();
      });
      document.getElementById("axes").append(
        element("label", { className: "control" }, element("span", { textContent: title }), list),
      );
    }
  }

  makeGrid() {
    const { gammas, eps } = this.aspect.contents;
    const table = document.querySelector("#map table");
    const row = (...cells) => element("tr", {}, ...cells);
    const corner = element("th", { scope: "col", textContent: "ε \\ γ" });
    table.replaceChildren(row(corner, ...gammas.map((one) => element("th", { scope: "col", textContent: one }))));
    this.cells = eps.map((radius, e) => {
      const cells = gammas.map((gamma, g) => {
        const cell = element("td");
        cell.setAttribute("role", "gridcell");
        cell.addEventListener("click", () => this.take({ gamma: g, eps: e }, true));
        cell.addEventListener("keydown", (event) => this.key(event, g, e));
        return cell;
      });
      table.append(row(element("th", { scope: "row", textContent: radius }), ...cells));
      return cells;
    });
    for (const one of table.rows) one.setAttribute("role", "row");
    for (const one of table.querySelectorAll("th")) {
      one.setAttribute("role", one.scope === "row" ? "rowheader" : "columnheader");
    }
  }

  key(event, gamma, eps) {
    const { gammas, eps: radii } = this.aspect.contents;
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const ends = { Home: [0, eps], End: [gammas.length - 1, eps] };
    let to = ends[event.key];
    if (event.key in steps) to = [gamma + steps[event.key][0], eps + steps[event.key][1]];
    if (event.key === "Enter" || event.key === " ") to = [gamma, eps];
    if (!to) return;
    event.preventDefault();
    if (to[0] < 0 || to[1] < 0 || to[0] >= gammas.length || to[1] >= radii.length) return;
    this.take({ gamma: to[0], eps: to[1] }, true);
  }

  take(cell, focus = false) {
    this.aspect.cell = cell;
    document.getElementById("copied").textContent = "";
    this.draw();
    if (cell && focus) this.cells[cell.eps][cell.gamma].focus();
    document.getElementById("told").textContent = document.getElementById("taken-title").textContent;
  }

  command() {
    const { isStored, gamma, eps, min_samples } = this.aspect.taken();
    if (isStored) return null;
    return `${this.aspect.contents.command} --gamma ${gamma} --eps ${eps} --min-samples ${min_samples}`;
  }

  draw() {
    this.drawMap();
    this.drawTaken();
  }

  drawMap() {
    const { aspect } = this;
    const { contents, cell: taken, stored } = aspect;
    const score = contents.scores.find((one) => one.key === this.shown);
    document.getElementById("map-title").textContent = score.title;
    document.getElementById("map-caption").textContent = MAP_CAPTIONS[this.shown.split(" ")[0]];
    const share = shareOf(this.shown);
    // One cell can be reached by Tab; the arrow keys lead to the others.
    const reached = taken ?? { gamma: Math.floor(contents.gammas.length / 2), eps: Math.floor(contents.eps.length / 2) };
    this.cells.forEach((line, e) =>
      line.forEach((cell, g) => {
        const value = aspect.value(this.shown, g, e);
        cell.textContent = shortValue(this.shown, value);
        const isTaken = taken !== null && taken.gamma === g && taken.eps === e;
        cell.setAttribute("aria-selected", String(isTaken));
        cell.tabIndex = reached.gamma === g && reached.eps === e ? 0 : -1;
        const isStored = stored !== null && stored.gamma === g && stored.eps === e && stored.points === aspect.points;
        cell.classList.toggle("stored", isStored);
        const name = `γ ${contents.gammas[g]}, ε ${contents.eps[e]}: ${spokenValue(this.shown, value)}`;
        cell.setAttribute("aria-label", isStored ? `${name}, stored in the study` : name);
        const colour = value === null || (this.shown === "clusters" && value < 2) ? null : scaleColour(share(value));
        cell.classList.toggle("plain", colour === null);
        cell.style.background = colour ?? "";
        cell.style.color = colour === null ? "" : readableOn(colour);
      }),
    );
    const [low, high] = this.shown === "clusters" ? ["2", "10 and more"] : isPercent(this.shown) ? ["0 %", "100 %"] : ["0", "1"];
    const bar = element("span", { className: "bar" });
    bar.style.background = `linear-gradient(to right, ${[0, 0.25, 0.5, 0.75, 1].map(scaleColour).join(", ")})`;
    document.getElementById("scale").replaceChildren(low, bar, high);
    document.getElementById("own").setAttribute("aria-pressed", String(taken === null));
  }

  drawTaken() {
    const { contents } = this.aspect;
    const taken = this.aspect.taken();
    const groups = groupsOf(taken.labels);
    const n = groups.filter((one) => one.label >= 0).length;
    const noise = groups.find((one) => one.label < 0)?.members.length ?? 0;
    const clusters = n === 1 ? "1 cluster" : `${n} clusters`;
    const settings = `γ ${shortNumber(taken.gamma)}, ${taken.eps === null ? "" : `ε ${shortNumber(taken.eps)}, `}min. points ${taken.min_samples}`;
    document.getElementById("taken-title").textContent = `${settings}: ${clusters}, ${noise} of ${taken.labels.length} noise`;
    document.getElementById("taken-about").textContent = this.about(taken);
    document.querySelector("#command code").textContent =
      this.command() ?? `${contents.command} # as stored in the study; take a setting in the map`;
    document.getElementById("copy").disabled = taken.isStored;
    this.drawSpace(groups, clusters);
    this.drawKernel(groups, clusters, taken);
    this.drawTable(groups);
  }

  about(taken) {
    const { contents } = this.aspect;
    const parts = [`By ${contents.name}${contents.compares ? ` (${contents.compares})` : ""}.`];
    if (taken.isStored) parts.push(`Stored in the study: ${taken.text}`);
    else if (contents.scale > 0) {
      const [unit, inverse] = contents.unit === "1" ? ["", ""] : [` ${contents.unit}`, ` 1/${squared(contents.unit)}`];
      const unscaled = shortNumber(taken.gamma / contents.scale ** 2);
      parts.push(
        `γ has no unit, since distances are divided by their median, ${shortNumber(contents.scale)}${unit}.` +
          ` For distances that are not, the same kernel has γ = ${unscaled}${inverse}.`,
      );
    }
    if (contents.rows.length < contents.scenarios) {
      parts.push(
        `The map shows a random sample of ${contents.rows.length} of ${contents.scenarios} scenarios, so the clusters of all can differ a little.`,
      );
    }
    return parts.join(" ");
  }

  drawSpace(groups, clusters) {
    const { parameters, scenarios } = this.contents;
    const [across, up] = this.axes.map((k) => parameters[k]);
    const picture = new Picture(document.getElementById("space"), rangeOf(across), rangeOf(up));
    picture.label(withUnit(across.name, across.unit), withUnit(up.name, up.unit), [across.choices, up.choices]);
    const columns = this.axes.map((k) => this.aspect.contents.rows.map((row) => scenarios.values[k][row]));
    picture.points(groups, columns, (k) => `scenario ${scenarios.id[this.aspect.contents.rows[k]]}`);
    picture.svg.setAttribute("aria-label", `Parameter space: ${up.name} over ${across.name}, ${clusters} in colours and symbols`);
  }

  drawKernel(groups, clusters, taken) {
    const ranges = taken.embedding.map((values) => finiteRange(values));
    // One scale for both axes, as the ring is round.
    const span = 1.08 * Math.max(...ranges.map(([low, high]) => high - low), 2.2 * (taken.eps ?? 0), 1e-6);
    const { width, height, left, right, top, bottom } = PICTURE;
    const shape = (width - left - right) / (height - top - bottom);
    const [x, y] = ranges.map(([low, high], k) => {
      const half = (span / 2) * (k === 0 ? shape : 1);
      return [(low + high) / 2 - half, (low + high) / 2 + half];
    });
    const picture = new Picture(document.getElementById("kernel"), x, y);
    picture.label("component 1 [–]", "component 2 [–]", [[], []]);
    const { rows } = this.aspect.contents;
    picture.points(groups, taken.embedding, (k) => `scenario ${this.contents.scenarios.id[rows[k]]}`);
    if (taken.eps !== null) picture.ring(taken.eps);
    picture.svg.setAttribute("aria-label", `Kernel space: components 1 and 2, ${clusters} in colours and symbols, ring of radius ε`);
  }

  drawTable(groups) {
    const { metrics, outcomes, scenarios } = this.contents;
    const { rows } = this.aspect.contents;
    const head = ["cluster", "scenarios", ...metrics.map((one) => `median ${withUnit(one.name, one.unit)}`), "most end so"];
    const lines = groups.map(({ label, members }) => {
      const mark = drawn("svg", { viewBox: "-7 -7 14 14", "aria-hidden": "true" });
      mark.append(markOf(label, 0, 0));
      const cells = [element("td", {}, mark, label < 0 ? "noise" : String(label)), element("td", { textContent: members.length })];
      for (const { name } of metrics) {
        const values = members.map((k) => scenarios.scores[name][rows[k]]).filter((one) => one !== null);
        cells.push(element("td", { textContent: shortNumber(medianOf(values)) }));
      }
      const counts = new Map();
      for (const k of members) {
        const outcome = scenarios.outcome[rows[k]];
        counts.set(outcome, (counts.get(outcome) ?? 0) + 1);
      }
      const [most, count] = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0])[0];
      const share = Math.round((100 * count) / members.length);
      cells.push(element("td", { className: "text", textContent: `${outcomes[most]} (${share} %)` }));
      return element("tr", {}, ...cells);
    });
    const titles = head.map((one, k) => {
      const cell = element("th", { scope: "col", textContent: one });
      if (k === head.length - 1) cell.className = "text";
      return cell;
    });
    document
      .getElementById("clusters")
      .replaceChildren(element("thead", {}, element("tr", {}, ...titles)), element("tbody", {}, ...lines));
  }
}

const MAP_CAPTIONS = {
  clusters: "A large ε joins clusters until one is left; a small one divides them, until all is noise. A large γ tells near scenarios apart, and takes far ones as equally far.",
  noise: "Share of the scenarios that are in no cluster.",
  stability: "How much of the clusters is found again in random parts of 80 % of the scenarios: 1 is all (adjusted Rand index). – is a single group.",
  agreement: "Adjusted mutual information with how a scenario ends: 1 if the clusters say all of it, about 0 if nothing.",
  explained: "Share of the variance of the score that the clusters explain, noise as one of them. More clusters explain more by themselves.",
};

function isPercent(key) {
  return key === "noise" || key.startsWith("explained");
}

function shareOf(key) {
  if (key === "clusters") return (value) => Math.min(1, (value - 2) / 8);
  const whole = isPercent(key) ? 100 : 1;
  return (value) => Math.max(0, Math.min(1, value / whole));
}

function shortValue(key, value) {
  if (value === null) return "–";
  if (key === "clusters" || isPercent(key)) return String(Math.round(value));
  return value.toFixed(2).replace(/^(-?)0\./, "$1.").replace("1.00", "1").replace("-.00", ".00");
}

function spokenValue(key, value) {
  if (value === null) return "nothing to say";
  if (key === "clusters") return value === 1 ? "1 cluster" : `${value} clusters`;
  return isPercent(key) ? `${Math.round(value)} %` : value.toFixed(2);
}

// Black or white, whichever has the greater contrast.
function readableOn(colour) {
  const parts = colour.match(/\d+/g).map((one) => Number(one) / 255);
  const [r, g, b] = parts.map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.179 ? "#000" : "#fff";
}

// Members of each cluster, the largest first and noise last.
function groupsOf(labels) {
  const groups = new Map();
  labels.forEach((one, k) => {
    const label = one === NOISE ? -1 : one;
    if (!groups.has(label)) groups.set(label, []);
    groups.get(label).push(k);
  });
  const order = (label) => (label < 0 ? Infinity : label);
  return [...groups].map(([label, members]) => ({ label, members })).sort((a, b) => order(a.label) - order(b.label));
}

function medianOf(values) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}

function rangeOf(parameter) {
  if (parameter.choices.length) return [-0.5, parameter.choices.length - 0.5];
  const { low, high } = parameter;
  return low < high ? [low, high] : [low - 0.5, high + 0.5];
}

function markOf(label, x, y) {
  const symbol = kindSymbol(label);
  const colour = kindColour(label);
  const attributes = { class: "mark", d: MARKS[symbol], transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})` };
  if (symbol === "ring") Object.assign(attributes, { fill: "none", stroke: colour });
  else Object.assign(attributes, { fill: colour, stroke: themeColours().raised });
  return drawn("path", attributes);
}

// Round numbers between two ends.
function ticksOf([low, high]) {
  const raw = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(6)));
}

// A frame with two axes and points.
class Picture {
  constructor(svg, x, y) {
    Object.assign(this, { svg, x, y });
    const { width, height, left, right, top, bottom } = PICTURE;
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.append(drawn("rect", { class: "frame", x: left, y: top, width: width - left - right, height: height - top - bottom }));
  }

  across(value) {
    const { width, left, right } = PICTURE;
    return left + ((value - this.x[0]) / (this.x[1] - this.x[0])) * (width - left - right);
  }

  up(value) {
    const { height, top, bottom } = PICTURE;
    return height - bottom - ((value - this.y[0]) / (this.y[1] - this.y[0])) * (height - top - bottom);
  }

  label(across, up, choices) {
    const { width, height, left, right, top, bottom } = PICTURE;
    const at = (k, range) => (choices[k].length ? choices[k].map((name, place) => [place, name.slice(0, 9)]) : ticksOf(range).map((one) => [one, String(one)]));
    for (const [value, text] of at(0, this.x)) {
      this.svg.append(drawn("text", { class: "tick", x: this.across(value), y: height - bottom + 15, "text-anchor": "middle" }, text));
    }
    for (const [value, text] of at(1, this.y)) {
      this.svg.append(drawn("text", { class: "tick", x: left - 5, y: this.up(value) + 4, "text-anchor": "end" }, text));
    }
    const middle = (top + height - bottom) / 2;
    this.svg.append(
      drawn("text", { class: "axis", x: (left + width - right) / 2, y: height - 8, "text-anchor": "middle" }, across),
      drawn("text", { class: "axis", transform: `translate(12 ${middle}) rotate(-90)`, "text-anchor": "middle" }, up),
    );
  }

  // The largest cluster first, so that the small ones lie on top.
  points(groups, columns, name) {
    for (const { label, members } of groups) {
      for (const k of members) {
        const mark = markOf(label, this.across(columns[0][k]), this.up(columns[1][k]));
        mark.append(drawn("title", {}, `${name(k)}, ${label < 0 ? "noise" : `cluster ${label}`}`));
        this.svg.append(mark);
      }
    }
  }

  ring(radius) {
    const { width, right, top } = PICTURE;
    const size = this.across(radius) - this.across(0);
    this.svg.append(drawn("circle", { class: "ring", cx: width - right - size - 6, cy: top + size + 6, r: size }));
  }
}

window.cornercase = { settings: new SettingsPage(JSON.parse(document.getElementById("contents").textContent)) };
document.documentElement.dataset.ready = "true";
