"use strict";

// Names of scenarios, ranges and numbers for readers.

function formatNumber(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  const extreme = size !== 0 && (size >= 1e6 || size < 1e-4);
  const text = extreme ? value.toExponential(3) : String(Number(value.toPrecision(size >= 1000 ? 7 : 4)));
  return text.replace("-", "−");
}

// With enough digits to distinguish numbers that differ by `step`, also far from 0.
function formatInSteps(value, step) {
  const digits = Math.floor(Math.log10(Math.abs(value) / step)) + 1;
  const plain = !Number.isFinite(value) || !(step > 0) || digits <= 4 || digits > 15;
  if (plain) return formatNumber(value);
  const decimals = Math.min(20, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  return String(Number(value.toFixed(decimals))).replace("-", "−");
}

function withUnit(value, unit, text = formatNumber(value)) {
  return unit && unit !== "1" && text !== "–" ? `${text} ${unit}` : text;
}

function parameterText(store, k, row) {
  const one = store.contents.parameters[k];
  const value = store.contents.scenarios.values[k][row];
  if (one.choices.length) return one.choices[value] ?? "–";
  return withUnit(value, one.unit, formatInSteps(value, (one.high - one.low) / 1000));
}

// Pairs of name and value that summarize a scenario.
function describeScenario(store, row, most = 10) {
  const { scenarios, parameters, metrics, outcomes, culprits, kept, errors } = store.contents;
  const id = scenarios.id[row];
  const lines = [];
  if (scenarios.failed[row]) lines.push(["failed", shortened(errors[id] ?? "", 90)]);
  for (const { name, unit } of metrics) {
    const score = scenarios.scores[name][row];
    const whom = store.against(name, row);
    if (score !== null) lines.push([name, withUnit(score, unit) + (whom === null ? "" : ` against ${whom}`)]);
  }
  parameters.slice(0, most).forEach((one, k) => lines.push([one.name, parameterText(store, k, row)]));
  if (parameters.length > most) lines.push(["more parameters", String(parameters.length - most)]);
  if (store.options.aspect !== null && !scenarios.failed[row]) lines.push(["kind", store.kindName(store.kindOf(row))]);
  if (scenarios.outcome[row] !== null) lines.push(["outcome", outcomes[scenarios.outcome[row]]]);
  if (scenarios.culprit[row] !== null) lines.push(["at fault", culprits[scenarios.culprit[row]]]);
  if (scenarios.critical[row]) lines.push(["critical", "yes"]);
  if (kept[id]) lines.push(["kept as", kept[id].role]);
  const note = store.notes.get(id);
  if (note) lines.push(["note", shortened(note, 90)]);
  return lines.map((line) => line.map(unturned));
}

// One sentence for screen readers.
function sayScenario(store, row) {
  const lines = describeScenario(store, row, 6).map(([name, value]) => `${name} ${value}`);
  return `Scenario ${store.contents.scenarios.id[row]}: ${lines.join(", ")}`;
}

function shortened(text, most) {
  const letters = Array.from(text);
  return letters.length > most ? `${letters.slice(0, most - 1).join("")}…` : text;
}

// The bounds of a filtered column, for instance "ego_start 30 to 45 m".
function rangeText(store, column) {
  const [low, high] = store.ranges.get(column);
  const [, key] = Store.split(column);
  const { choices, unit } = store.axis(column);
  const name = unturned(key) || (column === "id" ? "scenario" : column);
  if (choices.length) {
    const some = choices.filter((_, k) => k >= low && k <= high);
    return `${name}: ${some.join(", ") || "none"}`;
  }
  if (low === -Infinity) return `${name} up to ${withUnit(high, unit)}`;
  if (high === Infinity) return `${name} from ${withUnit(low, unit)}`;
  return `${name} ${formatNumber(low)} to ${withUnit(high, unit)}`;
}

function announce(text) {
  document.getElementById("told").textContent = text;
}

// The tooltip under the pointer.
class Tip {
  constructor() {
    this.box = document.createElement("div");
    this.box.id = "tip";
    this.box.hidden = true;
    this.box.setAttribute("aria-hidden", "true");
    document.body.append(this.box);
  }

  show(title, lines, x, y) {
    const strong = document.createElement("strong");
    strong.textContent = title;
    const list = document.createElement("dl");
    for (const [name, value] of lines) {
      const term = document.createElement("dt");
      const said = document.createElement("dd");
      term.textContent = name;
      said.textContent = value;
      list.append(term, said);
    }
    this.box.replaceChildren(strong, list);
    this.box.hidden = false;
    const { offsetWidth: width, offsetHeight: height } = this.box;
    const left = x + 14 + width > innerWidth ? x - 14 - width : x + 14;
    const top = y + 14 + height > innerHeight ? y - 14 - height : y + 14;
    this.box.style.left = `${Math.max(4, left)}px`;
    this.box.style.top = `${Math.max(4, top)}px`;
  }

  showScenario(store, row, x, y) {
    this.show(`Scenario ${store.contents.scenarios.id[row]}`, describeScenario(store, row), x, y);
  }

  hide() {
    this.box.hidden = true;
  }
}

let tipMade = null;

function tip() {
  tipMade ??= new Tip();
  return tipMade;
}
