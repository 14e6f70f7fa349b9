"use strict";

// A text without control characters for the writing direction, which would affect the text beside it.
function unturned(text) {
  return text.replace(/[\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/g, escaped);
}

function escaped(sign) {
  return `\\u${sign.charCodeAt(0).toString(16).padStart(4, "0")}`;
}

// Number of scenarios that sentences, tables and some views cover; null if they cover all.
function knownOf({ n, contents }) {
  return contents.known_of < n ? contents.known_of : null;
}

// Contents of the page and choices of its reader: views read and change it, and are notified of changes.
//
// Events: "contents" (scenarios came, live), "shown" (filters), "selected" (one of the two scenarios of the replay),
// "options" (metric, aspect, colour, axes), "hovered" (the scenario under the pointer), "theme".
class Store {
  constructor(contents) {
    this.listeners = new Map();
    this.filters = new Map();
    // Every brush is a range of a column, so that all views show each other's brushes.
    this.ranges = new Map();
    const aspect = Store.firstAspect(contents);
    const { outcomes, scenarios } = contents;
    const ends = outcomes?.length && new Set(scenarios.outcome.filter((one) => one !== null)).size > 1;
    // Kinds that tell nothing apart would hide what happened.
    const colour = contents.kinds[aspect]?.useful ? "kind" : ends ? "outcome" : "metric";
    this.options = { metric: contents.metrics[0].name, aspect, colour, surface: "off", hidden: "" };
    this.notes = new Map();
    this.selected = null;
    this.beside = null;
    this.hovered = null;
    this.version = 0;
    this.setContents(contents, false);
  }

  // With several others, the one a score belongs to; null with one other, or if it belongs to none in
  // particular.
  against(metric, row) {
    const { metrics, other, scenarios } = this.contents;
    const place = scenarios.against?.[row]?.[metrics.findIndex((one) => one.name === metric)] ?? null;
    return place === null ? null : other[place];
  }

  static firstAspect(contents) {
    const names = Object.keys(contents.kinds);
    if (names.includes(contents.default_aspect)) return contents.default_aspect;
    const metric = contents.metrics[0].name;
    // An aspect with several kinds is more useful than one with a single kind.
    const many = names.filter((name) => Object.keys(contents.kinds[name].names).length > 1);
    for (const some of [many, names]) {
      const best = [metric, "interaction"].find((name) => some.includes(name)) ?? some[0];
      if (best !== undefined) return best;
    }
    return null;
  }

  // Scenarios are rows 0 to n - 1 here; readers know them by their ids.
  setContents(contents, tell = true) {
    this.contents = contents;
    this.version += 1;
    this.n = contents.scenarios.id.length;
    this.rows = new Map(contents.scenarios.id.map((id, row) => [id, row]));
    this.columns = new Map();
    // The study may have been replaced.
    for (const slot of ["selected", "beside"]) if (!this.rows.has(this[slot])) this[slot] = null;
    // A growing study is analyzed later, or starts again.
    if (!Object.hasOwn(contents.kinds, this.options.aspect ?? "")) this.options.aspect = Store.firstAspect(contents);
    this.shown = new Uint8Array(this.n);
    this.applyFilters(false);
    if (tell) this.tell("contents");
  }

  // Notes by id; `NoteKeeper` stores them.
  setNotes(notes) {
    this.notes = new Map(Object.entries(notes).map(([id, text]) => [Number(id), text]));
    this.tell("notes");
  }

  setNote(id, text) {
    if (text) this.notes.set(id, text);
    else this.notes.delete(id);
    this.tell("notes");
  }

  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, []);
    this.listeners.get(event).push(listener);
  }

  tell(event, detail) {
    for (const listener of this.listeners.get(event) ?? []) listener(detail);
  }

  // A filter is called with the row of each scenario; null removes it. Its label is shown to the reader.
  filter(name, test, label = name) {
    if (test === null) {
      if (!this.filters.delete(name)) return;
    } else {
      this.filters.set(name, { test, label });
    }
    this.applyFilters();
  }

  // Ranges as [column, low, high]; if both are null, the range is removed.
  setRanges(ranges) {
    for (const [column, low, high] of ranges) {
      if (low === null && high === null) {
        this.ranges.delete(column);
        this.filters.delete(`range ${column}`);
        continue;
      }
      this.ranges.set(column, [low ?? -Infinity, high ?? Infinity]);
      const test = (row) => {
        const value = this.column(column)[row];
        return value >= (low ?? -Infinity) && value <= (high ?? Infinity);
      };
      this.filters.set(`range ${column}`, { test, label: rangeText(this, column), column });
    }
    this.applyFilters();
  }

  clearFilters() {
    this.filters.clear();
    this.ranges.clear();
    this.applyFilters();
    this.tell("cleared");
  }

  applyFilters(tell = true) {
    this.shown.fill(1);
    for (const { test } of this.filters.values()) {
      for (let row = 0; row < this.n; row++) if (this.shown[row] && !test(row)) this.shown[row] = 0;
    }
    this.shownCount = this.shown.reduce((sum, one) => sum + one, 0);
    if (tell) this.tell("shown");
  }

  // `slot` is "selected" or "beside"; an unknown id, or null, selects nothing.
  select(id, slot = "selected") {
    const other = slot === "beside" ? this.selected : null;
    const found = this.rows.has(id) && id !== other ? id : null;
    if (this[slot] === found) return;
    this[slot] = found;
    this.tell("selected", slot);
  }

  // The row under the pointer, or null.
  hover(row) {
    if (this.hovered === row) return;
    this.hovered = row;
    this.tell("hovered");
  }

  set(options) {
    const changed = Object.entries(options).filter(([name, value]) => this.options[name] !== value);
    if (!changed.length) return;
    Object.assign(this.options, options);
    this.tell("options", changed.map(([name]) => name));
  }

  // A column is "id", "round", "parameter NAME" or "score METRIC".
  column(name) {
    if (!this.columns.has(name)) this.columns.set(name, this.readColumn(name));
    return this.columns.get(name);
  }

  readColumn(name) {
    const { scenarios, parameters } = this.contents;
    if (name === "id" || name === "round") return Float64Array.from(scenarios[name]);
    const [kind, key] = Store.split(name);
    let values = null;
    if (kind === "score") values = scenarios.scores[key];
    else values = scenarios.values[parameters.findIndex((one) => one.name === key)];
    return Float64Array.from(values, (value) => value ?? NaN);
  }

  static split(name) {
    const at = name.indexOf(" ");
    return at < 0 ? [name, ""] : [name.slice(0, at), name.slice(at + 1)];
  }

  // The label of an axis with its unit, and the names of its numbers if they are choices.
  axis(name) {
    const [kind, key] = Store.split(name);
    if (!key) return { title: name === "id" ? "scenario [id]" : `${name} [1]`, choices: [] };
    const one = (kind === "score" ? this.contents.metrics : this.contents.parameters).find((each) => each.name === key);
    const said = unturned(key);
    return { title: one.unit ? `${said} [${one.unit}]` : said, unit: one.unit, choices: one.choices ?? [] };
  }

  // Whether the column exists: addresses are also typed by people.
  has(name) {
    const [kind, key] = Store.split(name);
    if (!key) return name === "id" || name === "round";
    const list = { score: this.contents.metrics, parameter: this.contents.parameters }[kind] ?? [];
    return list.some((each) => each.name === key);
  }

  metricOf(name = this.options.metric) {
    return this.contents.metrics.find((each) => each.name === name);
  }

  // Score from which a scenario is critical; null if there is none for the shown metric.
  threshold(name = this.options.metric) {
    const { critical, searched } = this.contents;
    const own = critical && searched === name;
    return own ? critical.threshold : null;
  }

  // Cluster of a scenario by the shown aspect: null if not assigned yet, -1 for noise.
  kindOf(row) {
    const { aspect } = this.options;
    return aspect === null ? null : this.contents.kinds[aspect].labels[row];
  }

  kindName(label) {
    if (label === null || this.options.aspect === null) return "in no cluster";
    return this.contents.kinds[this.options.aspect]?.names[String(label)] ?? (label < 0 ? "noise" : `${this.options.aspect} ${label}`);
  }
}
