"use strict";

// What the page knows and what its reader chose: views read it, change it, and are told when it changed.
//
// Events: "contents" (scenarios came, live), "shown" (filters), "selected" (one of the two scenarios of the replay),
// "options" (metric, aspect, colour, axes), "theme".
class Store {
  constructor(contents) {
    this.listeners = new Map();
    this.filters = new Map();
    this.options = { metric: contents.metrics[0].name, aspect: Store.firstAspect(contents), colour: null };
    this.selected = null;
    this.beside = null;
    this.setContents(contents, false);
  }

  static firstAspect(contents) {
    const names = Object.keys(contents.kinds);
    const metric = contents.metrics[0].name;
    return names.includes(metric) ? metric : names[0] ?? null;
  }

  // Scenarios are rows 0 to n - 1 here; people know them by their ids.
  setContents(contents, tell = true) {
    this.contents = contents;
    this.n = contents.scenarios.id.length;
    this.rows = new Map(contents.scenarios.id.map((id, row) => [id, row]));
    this.columns = new Map();
    if (this.options.aspect === null) this.options.aspect = Store.firstAspect(contents);
    this.shown = new Uint8Array(this.n);
    this.applyFilters(false);
    if (tell) this.tell("contents");
  }

  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, []);
    this.listeners.get(event).push(listener);
  }

  tell(event, detail) {
    for (const listener of this.listeners.get(event) ?? []) listener(detail);
  }

  // A filter is called by the row of each scenario; null takes it away. Its label is shown to the reader.
  filter(name, test, label = name) {
    if (test === null) {
      if (!this.filters.delete(name)) return;
    } else {
      this.filters.set(name, { test, label });
    }
    this.applyFilters();
  }

  clearFilters() {
    this.filters.clear();
    this.applyFilters();
    this.tell("cleared");
  }

  applyFilters(tell = true) {
    const tests = [...this.filters.values()].map((filter) => filter.test);
    let count = 0;
    for (let row = 0; row < this.n; row++) {
      const shown = tests.every((test) => test(row)) ? 1 : 0;
      this.shown[row] = shown;
      count += shown;
    }
    this.shownCount = count;
    if (tell) this.tell("shown");
  }

  // `slot` is "selected" or "beside"; an id that is not there, or null, selects nothing.
  select(id, slot = "selected") {
    const found = this.rows.has(id) ? id : null;
    if (this[slot] === found) return;
    this[slot] = found;
    this.tell("selected", slot);
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
    const values =
      kind === "score" ? scenarios.scores[key] : scenarios.values[parameters.findIndex((one) => one.name === key)];
    return Float64Array.from(values, (value) => value ?? NaN);
  }

  static split(name) {
    const at = name.indexOf(" ");
    return at < 0 ? [name, ""] : [name.slice(0, at), name.slice(at + 1)];
  }

  // What an axis is called, with its unit, and the names of its numbers where they stand for choices.
  axis(name) {
    const [kind, key] = Store.split(name);
    if (!key) return { title: name, choices: [] };
    const one = (kind === "score" ? this.contents.metrics : this.contents.parameters).find((each) => each.name === key);
    const unit = one.unit && one.unit !== "1" ? ` [${one.unit}]` : "";
    return { title: key + unit, choices: one.choices ?? [] };
  }

  // Cluster of a scenario by the aspect that is looked at: null where it is in none yet, -1 for noise.
  kindOf(row) {
    const { aspect } = this.options;
    return aspect === null ? null : this.contents.kinds[aspect].labels[row];
  }

  kindName(label) {
    if (label === null) return "in no cluster";
    return this.contents.kinds[this.options.aspect].names[String(label)] ?? (label < 0 ? "noise" : `cluster ${label}`);
  }
}
