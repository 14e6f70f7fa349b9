"use strict";

// The selection is part of the address, so that it can be shared: `#id=123&beside=45&kind=2&score=0:1.5`.
class Link {
  constructor(store, bar) {
    this.store = store;
    this.bar = bar;
    this.waiting = null;
    this.defaults = { ...store.options };
    this.read();
    for (const event of ["shown", "selected", "options"]) store.on(event, () => this.later());
    addEventListener("hashchange", () => this.read());
    addEventListener("popstate", () => this.read());
    // A scenario that a text of the page names is shown far from it.
    for (const part of document.querySelectorAll("#answers, #details, #verdicts")) {
      part.addEventListener("click", (event) => {
        if (event.target.closest("a[href^='#id=']")) document.querySelector("#replay")?.scrollIntoView();
      });
    }
  }

  // The address of the current selection, without "#".
  text() {
    const { store, bar, defaults } = this;
    const parts = [];
    const put = (name, value) => parts.push(`${encodeURIComponent(name)}=${encodeURIComponent(value)}`);
    if (store.selected !== null) put("id", store.selected);
    if (store.beside !== null) put("beside", store.beside);
    for (const [name, value] of Object.entries(store.options)) {
      if (value !== null && value !== undefined && value !== defaults[name]) put(name, value);
    }
    for (const [name, value] of Object.entries(bar.values)) if (value !== "") put(name, value);
    for (const [column, [low, high]] of store.ranges) {
      const range = [low, high].map((one) => (Number.isFinite(one) ? String(Number(one.toPrecision(9))) : ""));
      put(column === `score ${store.options.metric}` ? "score" : Link.nameOf(column), range.join(":"));
    }
    return parts.join("&").replaceAll("%3A", ":").replaceAll("%20", "+");
  }

  // One history entry for all changes within a moment; otherwise a brush would fill the history.
  later() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.write(), 250);
  }

  write() {
    this.waiting = null;
    const text = this.text();
    if (text === location.hash.slice(1)) return;
    const address = `${location.pathname}${location.search}${text ? `#${text}` : ""}`;
    try {
      history.pushState(null, "", address);
    } catch (error) {
      // A page in a notebook frame has no history, and some browsers limit the entries per minute.
      if (!(error instanceof DOMException)) throw error;
    }
  }

  read() {
    const { store, bar } = this;
    if (this.waiting === null && location.hash.slice(1) === this.text()) return;
    const found = new URLSearchParams(location.hash.slice(1));
    const options = { ...this.defaults };
    for (const name of Object.keys(options)) options[name] = this.option(name, found.get(name)) ?? options[name];
    for (const name of ["x", "y"]) options[name] = this.option(name, found.get(name)) ?? undefined;
    store.set(options);
    const values = {};
    for (const name of Object.keys(bar.values)) values[name] = found.get(name) ?? "";
    const ranges = [...store.ranges.keys()].map((column) => [column, null, null]);
    for (const [name, text] of found) {
      const column = name === "score" ? `score ${store.options.metric}` : Link.columnOf(name);
      if (column === null || !store.has(column)) continue;
      const [low, high] = text.split(":").map((one) => (one === "" ? null : Number(one)));
      if (![low, high].every((one) => one === null || Number.isFinite(one))) continue;
      const turned = low !== null && high !== null && low > high;
      ranges.push(turned ? [column, high, low] : [column, low, high]);
    }
    store.setRanges(ranges);
    bar.set(values);
    for (const [slot, name] of [["selected", "id"], ["beside", "beside"]]) {
      const id = found.get(name);
      store.select(id === null ? null : Number(id), slot);
    }
    clearTimeout(this.waiting);
    this.waiting = null;
  }

  // Names of a column's bounds in an address: "range.ego_start", "score.ttc", "range-of.round".
  static nameOf(column) {
    const [kind, key] = Store.split(column);
    if (!key) return `range-of.${kind}`;
    return kind === "score" ? `score.${key}` : `range.${key}`;
  }

  static columnOf(name) {
    for (const [begin, kind] of [["range.", "parameter "], ["score.", "score "], ["range-of.", ""]]) {
      if (name.startsWith(begin)) return kind + name.slice(begin.length);
    }
    return null;
  }

  // The value if it exists, else null, as for a page of another study.
  option(name, value) {
    if (value === null) return null;
    const { contents } = this.store;
    if (name === "metric") return contents.metrics.some((one) => one.name === value) ? value : null;
    if (name === "aspect") return Object.hasOwn(contents.kinds, value) ? value : null;
    if (name === "colour") return colourOptions(this.store).some(([each]) => each === value) ? value : null;
    if (name === "surface") return SURFACES.includes(value) ? value : null;
    if (name === "hidden") return value;
    return this.store.has(value) ? value : null;
  }
}
