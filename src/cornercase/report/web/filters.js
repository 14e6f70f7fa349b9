"use strict";

// The bar above the views: filters, display options, and a chip for each active filter.
class FilterBar {
  constructor(box, store) {
    this.store = store;
    this.values = { kind: "", outcome: "", culprit: "", kept: "", failed: "", critical: "" };
    const controls = document.createElement("div");
    controls.id = "filter-controls";
    const state = document.createElement("div");
    state.id = "filter-state";
    box.setAttribute("role", "group");
    box.setAttribute("aria-label", "Which scenarios are shown");
    box.append(controls, state);
    this.makeControls(controls);
    this.makeState(state);
    for (const event of ["contents", "shown", "options", "selected", "cleared"]) {
      store.on(event, (detail) => this.changed(event, detail));
    }
    this.refresh();
  }

  makeControls(box) {
    const { store } = this;
    this.metric = labelledSelect(box, "Metric", "metric");
    this.aspect = labelledSelect(box, "Kinds by", "aspect");
    this.colour = labelledSelect(box, "Colour", "colour");
    for (const name of ["metric", "aspect", "colour"]) {
      this[name].addEventListener("change", () => store.set({ [name]: this[name].value }));
    }
    this.selects = {};
    const texts = { kind: "Kind", outcome: "Outcome", culprit: "At fault", critical: "Critical", kept: "Kept", failed: "Failed" };
    for (const [name, text] of Object.entries(texts)) {
      this.selects[name] = labelledSelect(box, text, `filter-${name}`);
      this.selects[name].addEventListener("change", () => this.set({ [name]: this.selects[name].value }));
    }
    this.score = new RangeFields(box, store, { text: "Score", lowId: "filter-score-low", highId: "filter-score-high" });
  }

  makeState(box) {
    this.count = document.createElement("span");
    this.count.id = "shown-count";
    this.chips = document.createElement("div");
    this.chips.id = "chips";
    this.reset = document.createElement("button");
    this.reset.id = "reset-filters";
    this.reset.type = "button";
    this.reset.className = "button-quiet";
    this.reset.textContent = "Show all";
    this.reset.addEventListener("click", () => this.clear());
    this.chosen = document.createElement("div");
    this.chosen.id = "chosen";
    box.append(this.count, this.chips, this.reset, this.chosen);
  }

  clear() {
    for (const name of Object.keys(this.values)) this.values[name] = "";
    this.store.clearFilters();
    announce(this.count.textContent);
  }

  changed(event, detail) {
    if (event === "cleared") for (const name of Object.keys(this.values)) this.values[name] = "";
    // Cluster numbers of another aspect are different.
    if (event === "options" && detail.includes("aspect") && this.values.kind) this.set({ kind: "" });
    if (event === "contents") {
      this.applyAll();
      this.store.applyFilters(false);
    }
    this.refresh();
  }

  // Filters by name, as texts: values of the selects and of the address.
  set(values) {
    for (const [name, value] of Object.entries(values)) this.values[name] = this.known(name, value) ? value : "";
    this.applyAll();
    this.store.applyFilters();
    announce(this.count.textContent);
  }

  // Addresses may be typed by people, or belong to another study.
  known(name, value) {
    const { contents } = this.store;
    if (value === "") return true;
    if (name === "kind") return this.labels().some((label) => String(label ?? "none") === value);
    if (name === "outcome") return contents.outcomes.includes(value);
    if (name === "culprit") return contents.culprits.includes(value);
    return value === "0" || value === "1";
  }

  labels() {
    const { contents, options } = this.store;
    return options.aspect === null ? [] : [...new Set(contents.kinds[options.aspect].labels)];
  }

  applyAll() {
    const { store, values } = this;
    const { culprits, outcomes, scenarios } = store.contents;
    const put = (name, test, label) => {
      if (test === null) store.filters.delete(name);
      else store.filters.set(name, { test, label });
    };
    const kind = values.kind === "none" ? null : Number(values.kind);
    put("kind", values.kind === "" ? null : (row) => store.kindOf(row) === kind, `kind: ${store.kindName(kind)}`);
    const outcome = outcomes.indexOf(values.outcome);
    put("outcome", outcome < 0 ? null : (row) => scenarios.outcome[row] === outcome, `outcome: ${values.outcome}`);
    const culprit = culprits.indexOf(values.culprit);
    put("culprit", culprit < 0 ? null : (row) => scenarios.culprit[row] === culprit, `at fault: ${values.culprit}`);
    for (const name of ["kept", "failed", "critical"]) {
      const wanted = Number(values[name]);
      const test = values[name] === "" ? null : (row) => store.contents.scenarios[name][row] === wanted;
      put(name, test, wanted ? `${name} only` : `not ${name}`);
    }
  }

  refresh() {
    const { store } = this;
    const { contents, options } = store;
    setOptions(this.metric, contents.metrics.map(({ name }) => [name, name]), options.metric);
    this.metric.value = options.metric;
    const aspects = Object.keys(contents.kinds);
    setOptions(this.aspect, aspects.length ? aspects.map((name) => [name, name]) : [["", "not analysed"]]);
    this.aspect.disabled = !aspects.length;
    if (aspects.length) this.aspect.value = options.aspect;
    setOptions(this.colour, colourOptions(store));
    this.colour.value = options.colour;
    this.refreshSelects();
    this.score.show(`score ${options.metric}`);
    this.count.textContent = `${store.shownCount} of ${store.n} scenarios`;
    this.refreshChips();
    this.refreshChosen();
  }

  refreshSelects() {
    const { store } = this;
    const { contents } = store;
    const labels = this.labels();
    labels.sort((one, other) => (one ?? 1e9) - (other ?? 1e9));
    const kinds = labels.map((label) => [String(label ?? "none"), store.kindName(label)]);
    setOptions(this.selects.kind, [["", "any"], ...kinds]);
    setOptions(this.selects.outcome, [["", "any"], ...contents.outcomes.map((name) => [name, name])]);
    setOptions(this.selects.culprit, [["", "any"], ...contents.culprits.map((name) => [name, name])]);
    for (const name of ["kept", "failed", "critical"]) {
      setOptions(this.selects[name], [["", "any"], ["1", name], ["0", `not ${name}`]]);
      this.selects[name].disabled = !contents.scenarios[name].includes(1);
    }
    this.selects.kind.disabled = !kinds.length;
    this.selects.outcome.disabled = !contents.outcomes.length;
    // Only collisions have one, and a page that grows does not know it.
    this.selects.culprit.parentElement.hidden = !contents.culprits.length;
    for (const [name, select] of Object.entries(this.selects)) {
      select.value = this.values[name];
      if (select.selectedIndex < 0) select.value = "";
    }
  }

  refreshChips() {
    const { store } = this;
    const names = [...store.filters.keys()];
    this.reset.hidden = !names.length;
    const chips = names.map((name) => {
      const { label, column } = store.filters.get(name);
      const chip = document.createElement("button");
      chip.type = "button";
      chip.className = "chip";
      chip.textContent = label;
      chip.setAttribute("aria-label", `Take away the filter ${label}`);
      chip.addEventListener("click", () => {
        if (column) store.setRanges([[column, null, null]]);
        else if (name in this.values) this.set({ [name]: "" });
        else store.filter(name, null);
        (this.chips.querySelector("button") ?? this.metric).focus();
      });
      return chip;
    });
    this.chips.replaceChildren(...chips);
  }

  refreshChosen() {
    const { store } = this;
    const parts = ["selected", "beside"].filter((slot) => store[slot] !== null).map((slot) => {
      const mark = document.createElement("span");
      mark.className = "mark";
      mark.dataset.slot = slot;
      const row = store.rows.get(store[slot]);
      const { metric } = store.options;
      const score = store.contents.scenarios.scores[metric][row];
      const text = score === null ? "" : `, ${metric} ${withUnit(score, store.metricOf().unit)}`;
      mark.textContent = `${slot === "selected" ? "Scenario" : "beside"} ${store[slot]}${text}`;
      return mark;
    });
    if (parts.length) {
      const jump = document.createElement("button");
      jump.type = "button";
      jump.id = "to-replay";
      jump.className = "button-quiet";
      jump.textContent = "See it move";
      jump.addEventListener("click", () => document.getElementById("replay").scrollIntoView());
      parts.push(jump);
    }
    this.chosen.replaceChildren(...parts);
  }
}

function colourOptions(store) {
  const { kinds, outcomes, parameters } = store.contents;
  const options = [["metric", "score of the metric"]];
  if (Object.keys(kinds).length) options.unshift(["kind", "kind"]);
  if (outcomes.length) options.push(["outcome", "outcome"]);
  options.push(["critical", "critical"], ["round", "round"]);
  return [...options, ...parameters.map(({ name }) => [`parameter ${name}`, name])];
}
