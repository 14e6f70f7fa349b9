"use strict";

// Controls shared by several views and the filter bar.

function labelledSelect(box, text, id) {
  const label = document.createElement("label");
  label.className = "control";
  const name = document.createElement("span");
  name.textContent = text;
  const select = document.createElement("select");
  select.id = id;
  label.append(name, select);
  box.append(label);
  return select;
}

// Options as [value, text]; the choice is kept if it still exists.
function setOptions(select, options, value = select.value) {
  const key = JSON.stringify(options);
  if (select.dataset.key !== key) {
    select.dataset.key = key;
    select.replaceChildren(
      ...options.map(([each, text]) => {
        const option = document.createElement("option");
        option.value = each;
        option.textContent = shortened(unturned(text), 60);
        return option;
      }),
    );
  }
  if (options.some(([each]) => each === value)) select.value = value;
}

function columnName(name) {
  const [kind, key] = Store.split(name);
  if (kind === "score") return `score: ${key}`;
  if (!key) return name === "id" ? "scenario (id)" : "round";
  return key;
}

// Two fields for the bounds of a column: a brush for the keyboard.
class RangeFields {
  constructor(box, store, { text, lowId, highId }) {
    this.store = store;
    const set = document.createElement("fieldset");
    set.className = "control";
    const legend = document.createElement("legend");
    const pair = document.createElement("div");
    pair.className = "pair";
    this.legend = legend;
    this.fields = [["from", lowId], ["to", highId]].map(([name, id], k) => {
      const field = document.createElement("input");
      field.type = "number";
      field.step = "any";
      field.placeholder = name;
      if (id) field.id = id;
      field.addEventListener("change", () => this.change());
      field.addEventListener("blur", () => this.column !== null && this.show(this.column));
      if (k) pair.append("–");
      pair.append(field);
      return field;
    });
    set.append(legend, pair);
    box.append(set);
    this.text = text;
    this.column = null;
  }

  change() {
    let [low, high] = this.fields.map((field) => (field.value === "" ? null : Number(field.value)));
    if (low !== null && high !== null && low > high) [low, high] = [high, low];
    this.entered = document.activeElement;
    this.store.setRanges([[this.column, low, high]]);
    this.show(this.column);
    this.entered = null;
  }

  show(column) {
    this.column = column;
    const title = this.store.axis(column).title;
    this.legend.textContent = this.text ? `${this.text} ${title}` : title;
    const range = this.store.ranges.get(column) ?? [-Infinity, Infinity];
    this.fields.forEach((field, k) => {
      field.setAttribute("aria-label", `${title} ${k ? "to" : "from"}`);
      const value = Number.isFinite(range[k]) ? String(Number(range[k].toPrecision(5))) : "";
      if ((document.activeElement !== field || field === this.entered) && field.value !== value) field.value = value;
    });
  }
}

// A collapsible part of a view with two fields for each column; returns its update function.
function rangeMenu(box, store, columns) {
  const details = document.createElement("details");
  details.className = "menu";
  const summary = document.createElement("summary");
  summary.textContent = "Ranges in numbers";
  const inner = document.createElement("div");
  inner.className = "ranges";
  details.append(summary, inner);
  box.append(details);
  let fields = [];
  const fill = () => {
    if (!details.open) return;
    const names = [...new Set(columns())];
    if (names.length !== fields.length) {
      inner.replaceChildren();
      fields = names.map(() => new RangeFields(inner, store, {}));
    }
    names.forEach((name, k) => fields[k].show(name));
  };
  details.addEventListener("toggle", fill);
  return fill;
}

function onlyMarks(events) {
  return [...events].every((one) => one === "selected" || one === "hovered");
}
