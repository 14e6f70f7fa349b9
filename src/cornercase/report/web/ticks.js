"use strict";

// Scenarios that the reader ticked in the table, by id, to export them. Listeners of "ticked" are told of changes.
class Ticks {
  constructor(store) {
    this.store = store;
    this.ids = new Set();
    this.anchor = null;
    store.on("contents", () => this.forget((id) => !store.rows.has(id)));
    // Another search has the same ids for other scenarios.
    store.on("replaced", () => this.forget(() => true));
  }

  get size() {
    return this.ids.size;
  }

  has(row) {
    return this.ids.has(this.store.contents.scenarios.id[row]);
  }

  set(rows, on) {
    const { id } = this.store.contents.scenarios;
    for (const row of rows) {
      if (on) this.ids.add(id[row]);
      else this.ids.delete(id[row]);
    }
    this.store.tell("ticked");
  }

  // One row; with `range`, all of the sorted `rows` from the one that was ticked before.
  tick(rows, row, on, range) {
    const [from, to] = [rows.indexOf(this.anchor), rows.indexOf(row)];
    const isRange = range && from >= 0 && to >= 0;
    this.set(isRange ? rows.slice(Math.min(from, to), Math.max(from, to) + 1) : [row], on);
    if (!isRange) this.anchor = row;
    const what = isRange ? `${Math.abs(to - from) + 1} scenarios are` : `Scenario ${this.store.contents.scenarios.id[row]} is`;
    announce(`${what} ${on ? "ticked" : "not ticked"}, ${this.size} in all`);
  }

  clear() {
    this.ids.clear();
    this.anchor = null;
    this.store.tell("ticked");
  }

  forget(test) {
    const gone = [...this.ids].filter(test);
    if (!gone.length) return;
    gone.forEach((id) => this.ids.delete(id));
    this.anchor = null;
    this.store.tell("ticked");
  }

  // Rows that are ticked, whether the filters show them or not.
  rows() {
    return [...this.ids].map((id) => this.store.rows.get(id));
  }
}

// Below the table: what is ticked, and how to take it along.
class ExportBar {
  constructor(box, store, table) {
    Object.assign(this, { store, table });
    const bar = document.createElement("div");
    bar.className = "options export";
    bar.setAttribute("role", "group");
    bar.setAttribute("aria-label", "Take scenarios along");
    this.count = document.createElement("span");
    this.count.id = "ticked-count";
    this.untick = this.button("untick", () => table.ticks.clear());
    this.untick.textContent = "Untick";
    this.untick.className = "button-quiet";
    this.csv = this.button("table-csv", () => this.saveCsv());
    this.copy = this.button("copy-files-command", async () => this.say(await copyText(this.command(), "The command")));
    this.copy.textContent = "Copy command for .xosc files";
    bar.append(this.count, this.untick, this.csv, this.copy);
    this.pre = document.createElement("pre");
    this.pre.id = "files-command";
    this.pre.tabIndex = 0;
    this.pre.setAttribute("aria-label", "Command that writes these scenarios as OpenSCENARIO files");
    this.said = document.createElement("p");
    this.said.className = "note";
    this.said.setAttribute("role", "status");
    box.append(bar, this.pre, this.said);
    store.on("ticked", () => this.refresh());
  }

  button(id, act) {
    const button = document.createElement("button");
    button.type = "button";
    button.id = id;
    button.addEventListener("click", act);
    return button;
  }

  say(text) {
    this.said.textContent = text;
  }

  // Ticked rows, or without any all that are shown, in the order of the table.
  rows() {
    const { ticks, rows } = this.table;
    return ticks.size ? this.table.sorted(ticks.rows()) : rows;
  }

  refresh() {
    const { store } = this;
    const { ticks } = this.table;
    const shown = ticks.rows().filter((row) => store.shown[row]).length;
    const hidden = ticks.size - shown;
    this.count.textContent = ticks.size
      ? `${ticks.size} ticked${hidden ? `, ${hidden} of them not shown` : ""}`
      : `None ticked: all ${this.table.rows.length} shown`;
    this.untick.hidden = !ticks.size;
    this.csv.textContent = "Table (CSV)";
    this.csv.disabled = !this.rows().length;
    const command = this.command();
    this.copy.disabled = command === null;
    this.copy.title = command === null ? this.why() : "";
    this.pre.hidden = command === null || !ticks.size;
    this.pre.textContent = command ?? "";
    this.say(ticks.size && command === null ? this.why() : "");
  }

  // The command that writes the rows as files; null if there is none.
  command() {
    const { store } = this;
    const { study, rerun } = store.contents;
    if (!rerun?.has_scenario) return null;
    const ids = idRanges(this.rows().map((row) => store.contents.scenarios.id[row]));
    const file = study.startsWith("-") ? `./${study}` : study;
    const words = ["cornercase", "reduce", file, "--ids", ids, "-o", `${rerun.name}-chosen`];
    const command = words.map((word) => shellWord(word)).join(" ");
    const isUnsafe = words.some((word) => /[\u0000-\u001f\u007f-\u009f]/.test(word));
    return isUnsafe || !ids || command.length > LONGEST_COMMAND ? null : command;
  }

  why() {
    if (!this.store.contents.rerun?.has_scenario) return "The scenarios of a suite are files already, and imported recordings have none.";
    return this.rows().length ? "Too many scenarios for one command: tick fewer." : "";
  }

  saveCsv() {
    const rows = this.rows();
    const columns = this.table.columns.filter((column) => column.raw || column.text);
    const lines = [columns.map(({ title }) => csvCell(title)).join(",")];
    for (const row of rows) lines.push(columns.map((column) => csvCell(rawText(column, row))).join(","));
    const name = this.store.contents.rerun?.name ?? "study";
    saveFile(`${lines.join("\n")}\n`, `${name}-scenarios.csv`, "text/csv");
    this.say(`${rows.length} scenarios are in the file, with the columns of the table.`);
  }
}

// What a command line of Windows takes.
const LONGEST_COMMAND = 8000;

// Ids as a command takes them, for instance "3,17-20".
function idRanges(ids) {
  const sorted = [...ids].sort((one, other) => one - other);
  const parts = [];
  for (let k = 0; k < sorted.length; ) {
    let last = k;
    while (last + 1 < sorted.length && sorted[last + 1] === sorted[last] + 1) last++;
    parts.push(last > k ? `${sorted[k]}-${sorted[last]}` : String(sorted[k]));
    k = last + 1;
  }
  return parts.join(",");
}

// The value of a cell with all digits.
function rawText(column, row) {
  const value = column.raw ? column.raw(row) : column.text(row);
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  return typeof value === "number" ? numberText(value) : value;
}
