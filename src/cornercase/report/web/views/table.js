"use strict";

// Rows in print; sort or filter to choose others.
const MOST_PRINTED = 100;

// All filtered scenarios as rows; only visible ones are in the document.
class ScenarioTable {
  constructor(box, store) {
    this.store = store;
    this.sorting = { key: "id", down: false };
    this.current = null;
    this.height = 28;
    this.grid = document.createElement("div");
    this.grid.className = "grid";
    this.grid.tabIndex = 0;
    this.grid.setAttribute("role", "grid");
    this.grid.setAttribute(
      "aria-label", "Scenarios: arrow keys move, Enter selects, Shift and Enter puts beside, Space ticks, Shift for ranges");
    this.head = document.createElement("div");
    this.head.className = "row head";
    this.head.setAttribute("role", "row");
    this.body = document.createElement("div");
    this.body.className = "body";
    this.body.setAttribute("role", "rowgroup");
    const top = document.createElement("div");
    top.setAttribute("role", "rowgroup");
    top.style.display = "contents";
    top.append(this.head);
    this.grid.append(top, this.body);
    this.onPaper = document.createElement("p");
    this.onPaper.className = "note on-paper";
    this.printing = false;
    this.ticks = new Ticks(store);
    this.rows = [];
    this.menu = new ColumnMenu(box, store);
    box.append(this.onPaper, this.grid);
    this.bar = new ExportBar(box, store, this);
    store.on("ticked", () => this.markRows());
    addEventListener("beforeprint", () => this.print(true));
    addEventListener("afterprint", () => this.print(false));
    this.grid.addEventListener("scroll", () => this.drawRows(), { passive: true });
    this.grid.addEventListener("keydown", (event) => this.key(event));
    this.grid.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.body.addEventListener("click", (event) => {
      const row = this.rowOf(event);
      if (row === null) return;
      this.current = this.rows.indexOf(row);
      if (event.target.closest(".tick")) return this.tick(row, event.shiftKey);
      chooseRow(store, row, event);
    });
    this.body.addEventListener("pointermove", (event) => store.hover(this.rowOf(event)));
    this.body.addEventListener("pointerleave", () => store.hover(null));
    new ResizeObserver(() => this.drawRows()).observe(this.grid);
  }

  // Without the focus, the page scrolls, so that a reader on the way down is not caught here.
  wheel(event) {
    const isAcross = event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY);
    if (event.ctrlKey || isAcross || this.grid.contains(document.activeElement)) return;
    event.preventDefault();
    const unit = [1, 16, innerHeight][event.deltaMode] ?? 1;
    window.scrollBy({ top: event.deltaY * unit, behavior: "instant" });
  }

  tick(row, range) {
    this.ticks.tick(this.rows, row, !this.ticks.has(row), range);
    this.grid.focus({ preventScroll: true });
  }

  rowOf(event) {
    const element = event.target.closest("[data-row]");
    return element === null ? null : Number(element.dataset.row);
  }

  makeColumns() {
    const { store } = this;
    const { contents } = store;
    const { scenarios } = contents;
    const id = { key: "id", title: "id", number: true, text: (row) => String(scenarios.id[row]) };
    const columns = [id];
    for (const { name } of contents.metrics) {
      const key = `score ${name}`;
      const text = (row) => formatNumber(scenarios.scores[name][row]);
      columns.push({ key, title: store.axis(key).title, number: true, text, raw: (row) => scenarios.scores[name][row] });
    }
    const course = courseColumn(store, () => this.drawRows());
    if (course) columns.push(course);
    if (scenarios.against) {
      for (const { name } of contents.metrics) {
        const text = (row) => unturned(store.against(name, row) ?? "");
        const value = (row) => contents.other.indexOf(store.against(name, row));
        columns.push({ key: `other ${name}`, title: `other by ${name}`, text, value });
      }
    }
    columns.push(...this.markColumns());
    contents.parameters.forEach((one, k) => {
      const key = `parameter ${one.name}`;
      const named = one.choices.length > 0;
      const step = (one.high - one.low) / 1000;
      const text = (row) => (named ? parameterText(store, k, row) : formatInSteps(scenarios.values[k][row], step));
      const raw = named ? undefined : (row) => scenarios.values[k][row];
      columns.push({ key, title: named ? one.name : store.axis(key).title, number: !named, text, raw });
    });
    if (contents.outcomes.length) {
      const text = (row) => contents.outcomes[scenarios.outcome[row]] ?? "";
      const value = (row) => scenarios.outcome[row] ?? Infinity;
      columns.push({ key: "outcome", title: "outcome", text, value });
    }
    if (contents.culprits.length) {
      const text = (row) => contents.culprits[scenarios.culprit[row]] ?? "";
      const value = (row) => scenarios.culprit[row] ?? Infinity;
      columns.push({ key: "culprit", title: "at fault", text, value });
    }
    if (store.options.aspect !== null) {
      const text = (row) => (scenarios.failed[row] ? "" : store.kindName(store.kindOf(row)));
      // The kinds of a suite are those of the runs that it was chosen from.
      const title = contents.rerun?.command?.files?.length ? "kind when chosen" : "kind";
      columns.push({ key: "kind", title, width: 18, text, value: (row) => store.kindOf(row) ?? Infinity });
    }
    columns.push({ key: "round", title: "round", number: true, text: (row) => String(scenarios.round[row]) });
    this.all = columns;
    const hidden = hiddenColumns(store);
    this.columns = [this.tickColumn(), id, ...columns.slice(1).filter(({ key }) => !hidden.has(key))];
    this.menu.show(columns.slice(1));
  }

  tickColumn() {
    const fill = (cell, row) => {
      cell.classList.add("tick");
      cell.append(tickBox(`Tick scenario ${this.store.contents.scenarios.id[row]}`, -1));
    };
    return { key: "tick", title: "", width: 1.8, fill, head: (cell) => this.fillTickHead(cell) };
  }

  fillTickHead(cell) {
    cell.classList.add("tick");
    this.allBox = tickBox("Tick all shown", 0);
    this.allBox.addEventListener("change", () => {
      this.ticks.set(this.rows, this.allBox.checked);
      announce(`${this.ticks.size} scenarios are ticked`);
    });
    cell.append(this.allBox);
    this.markAll();
  }

  markAll() {
    if (!this.allBox) return;
    const count = this.rows.reduce((sum, row) => sum + this.ticks.has(row), 0);
    this.allBox.checked = count > 0 && count === this.rows.length;
    this.allBox.indeterminate = count > 0 && count < this.rows.length;
  }

  // As wide as the title and the values of some rows.
  fitColumns() {
    const some = evenly(this.rows, 40);
    for (const column of this.columns) {
      if (column.width !== undefined) continue;
      const longest = some.reduce((most, row) => Math.max(most, column.text(row).length), 0);
      const wide = Math.max(column.title.length * 0.53 + 1.9, longest * 0.47 + 1.3);
      column.width = Math.max(3.6, Math.min(14, wide));
    }
  }

  // Properties that only some scenarios have: those scenarios come first when sorted.
  markColumns() {
    const { store } = this;
    const { scenarios, kept, errors } = store.contents;
    const words = {
      critical: () => "critical",
      kept: (id) => kept[id]?.role ?? "kept",
      failed: (id) => `failed: ${errors[id] ?? ""}`,
    };
    const columns = Object.keys(words).filter((name) => scenarios[name].includes(1)).map((name) => ({
      key: name,
      title: name,
      width: name === "failed" ? 14 : undefined,
      text: (row) => (scenarios[name][row] ? words[name](scenarios.id[row]) : ""),
      value: (row) => -scenarios[name][row],
    }));
    if (store.notes?.size) {
      const note = (row) => store.notes.get(scenarios.id[row]) ?? "";
      const text = (row) => (note(row) ? `✎ ${note(row)}` : "");
      columns.push({ key: "note", title: "note", width: 14, text, raw: note, value: (row) => (note(row) ? 0 : 1) });
    }
    return columns;
  }

  drawHead() {
    this.head.replaceChildren(
      ...this.columns.map((column) => {
        const cell = this.cell(column, "columnheader");
        if (column.fill) {
          if (column.head) column.head(cell);
          else cell.textContent = unturned(column.title);
          return cell;
        }
        const button = document.createElement("button");
        button.type = "button";
        button.className = "sort";
        const { key, down } = this.sorting;
        button.textContent = column.title + (column.key === key ? (down ? " ↓" : " ↑") : "");
        cell.setAttribute("aria-sort", column.key !== key ? "none" : down ? "descending" : "ascending");
        button.addEventListener("click", () => this.sort(column.key));
        cell.append(button);
        return cell;
      }),
    );
  }

  cell(column, role) {
    const cell = document.createElement("div");
    cell.className = column.number ? "cell number" : "cell";
    cell.setAttribute("role", role);
    cell.style.width = `${column.width}rem`;
    return cell;
  }

  sort(key) {
    const down = this.sorting.key === key && !this.sorting.down;
    this.sorting = { key, down };
    this.grid.scrollTop = 0;
    this.redraw(new Set(["shown"]));
    const at = this.columns.findIndex((one) => one.key === key);
    this.head.children[at]?.querySelector("button").focus();
    announce(`Sorted by ${key}, ${down ? "falling" : "rising"}`);
  }

  redraw(events) {
    if (["contents", "shown", "options", "notes"].some((one) => events.has(one))) {
      this.makeColumns();
      this.order();
      this.fitColumns();
      this.drawHead();
      this.measure();
      if (events.has("shown")) this.current = null;
      this.bar.refresh();
    }
    if (events.has("selected")) this.reveal();
    // A press between two rows that replaced each other would be no click.
    if (onlyMarks(events)) this.markRows();
    else this.drawRows();
  }

  order() {
    this.rows = this.sorted(rowsWhere(this.store, (row) => this.store.shown[row]));
  }

  sorted(rows) {
    const { store } = this;
    const column = this.all.find((one) => one.key === this.sorting.key) ?? this.all[0];
    const of = column.value ?? ((values) => (row) => values[row])(store.column(column.key));
    const keys = Float64Array.from({ length: store.n }, (_, row) => of(row));
    const sign = this.sorting.down ? -1 : 1;
    // Missing values come last in both directions.
    return rows.sort((one, other) => {
      const [a, b] = [keys[one], keys[other]];
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b) || one - other;
      return sign * (a - b || 0) || one - other;
    });
  }

  measure() {
    this.grid.setAttribute("aria-rowcount", String(this.rows.length + 1));
    this.grid.setAttribute("aria-colcount", String(this.columns.length));
    this.body.style.height = `${this.rows.length * this.height}px`;
    const wide = this.columns.reduce((sum, one) => sum + one.width, 0);
    this.body.style.width = this.head.style.width = `max(100%, ${wide}rem)`;
  }

  print(printing) {
    this.printing = printing;
    this.drawRows();
  }

  drawRows() {
    if (!this.columns) return;
    const first = this.printing ? 0 : Math.max(0, Math.floor(this.grid.scrollTop / this.height) - 3);
    const count = this.printing ? MOST_PRINTED : Math.ceil((this.grid.clientHeight || 400) / this.height) + 6;
    this.onPaper.textContent = tellPrinted(this.rows.length);
    const rows = this.rows.slice(first, first + count);
    this.body.replaceChildren(...rows.map((row, k) => this.makeRow(row, first + k)));
    const { scrollWidth, scrollLeft, clientWidth } = this.grid;
    this.grid.classList.toggle("more", scrollWidth - scrollLeft > clientWidth + 2);
    this.pointAtCurrent();
  }

  // Tells screen readers which row the arrow keys are at, if it is drawn.
  pointAtCurrent() {
    const line = this.current === null ? null : document.getElementById(`scenario-row-${this.rows[this.current]}`);
    if (line) this.grid.setAttribute("aria-activedescendant", line.id);
    else this.grid.removeAttribute("aria-activedescendant");
  }

  makeRow(row, at) {
    const id = this.store.contents.scenarios.id[row];
    const line = document.createElement("div");
    line.className = "row";
    line.id = `scenario-row-${row}`;
    line.dataset.row = row;
    line.dataset.scenario = id;
    line.setAttribute("role", "row");
    line.setAttribute("aria-rowindex", String(at + 2));
    line.style.top = `${at * this.height}px`;
    for (const column of this.columns) {
      const cell = this.cell(column, "gridcell");
      line.append(cell);
      if (column.fill) {
        column.fill(cell, row);
        continue;
      }
      cell.textContent = unturned(column.text(row));
      if (!column.number && cell.textContent.length > 18) cell.title = cell.textContent;
    }
    this.mark(line, row);
    return line;
  }

  mark(line, row) {
    const { store } = this;
    const id = store.contents.scenarios.id[row];
    line.setAttribute("aria-selected", String(id === store.selected));
    line.classList.toggle("beside", id === store.beside);
    line.classList.toggle("hovered", row === store.hovered);
    const box = line.querySelector(".tick input");
    if (box) box.checked = this.ticks.has(row);
    line.classList.toggle("current", this.current !== null && row === this.rows[this.current]);
  }

  // What is selected and under the pointer, in the rows that are drawn.
  markRows() {
    for (const line of this.body.children) this.mark(line, Number(line.dataset.row));
    this.markAll();
    this.pointAtCurrent();
  }

  // Scrolls to the selected scenario.
  reveal() {
    const row = this.store.rows.get(this.store.selected);
    const at = row === undefined ? -1 : this.rows.indexOf(row);
    if (at >= 0) this.scrollTo(at);
  }

  scrollTo(at) {
    const top = at * this.height;
    const inner = this.grid.clientHeight - this.head.offsetHeight;
    if (top < this.grid.scrollTop) this.grid.scrollTop = top;
    else if (top + this.height > this.grid.scrollTop + inner) this.grid.scrollTop = top + this.height - inner;
  }

  key(event) {
    if (event.target !== this.grid || !this.rows.length) return;
    const page = Math.max(1, Math.floor(this.grid.clientHeight / this.height) - 2);
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity };
    if (event.key in steps) {
      const from = this.current ?? this.rows.indexOf(this.store.rows.get(this.store.selected));
      this.current = Math.max(0, Math.min(this.rows.length - 1, from + steps[event.key]));
      this.scrollTo(this.current);
      this.store.hover(this.rows[this.current]);
      this.drawRows();
    } else if (event.key === " " && this.current !== null) {
      this.tick(this.rows[this.current], event.shiftKey);
    } else if (event.key === "Enter" && this.current !== null) {
      chooseRow(this.store, this.rows[this.current], event);
    } else {
      return;
    }
    event.preventDefault();
  }
}

function tickBox(label, tabIndex) {
  const box = document.createElement("input");
  box.type = "checkbox";
  box.tabIndex = tabIndex;
  box.setAttribute("aria-label", label);
  return box;
}

function tellPrinted(count) {
  return count > MOST_PRINTED ? `The first ${MOST_PRINTED} of ${count}, sorted as on the screen.` : "";
}

VIEWS.push({
  name: "table",
  title: "Table",
  wide: true,
  about: "The scenarios that the filters leave.",
  more:
    "Click the head of a column to sort, a row to see the scenario move; then the wheel scrolls the table, else the page.",
  wanted: () => true,
  create(box, store) {
    const table = new ScenarioTable(box, store);
    return { table, redraw: (events) => table.redraw(events) };
  },
});
