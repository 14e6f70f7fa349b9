"use strict";

// Maps numbers to pixels along an axis, from pixel `from` to pixel `to`.
class Scale {
  constructor(low, high, from, to, choices = []) {
    this.choices = choices;
    const pad = choices.length ? 0.5 : (high - low || Math.abs(low) || 1) * 0.04;
    this.low = choices.length ? -pad : low - pad;
    this.high = choices.length ? choices.length - 1 + pad : high + pad;
    this.from = from;
    this.to = to;
  }

  at(value) {
    return this.from + ((value - this.low) / (this.high - this.low)) * (this.to - this.from);
  }

  value(pixel) {
    return this.low + ((pixel - this.from) / (this.to - this.from)) * (this.high - this.low);
  }

  // Round numbers about `apart` pixels from each other, each with its text.
  ticks(apart) {
    const most = Math.max(2, Math.abs(this.to - this.from) / apart);
    if (this.choices.length) {
      const each = Math.ceil(this.choices.length / most);
      return this.choices.map((name, k) => [k, shortened(name, 14)]).filter(([k]) => k % each === 0);
    }
    const rough = (this.high - this.low) / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * ([1, 2, 5].find((one) => one * power >= rough) ?? 10);
    const ticks = [];
    // Far from 0 a step may be lost in rounding, and the loop would not end.
    for (let k = Math.ceil(this.low / step); k * step <= this.high && ticks.length < 3 * most; k++) {
      ticks.push([k * step, formatInSteps(k * step, step)]);
    }
    return ticks;
  }
}

// A drawing on two canvases: the lower one changes with filters, the upper one with the pointer.
// Subclasses draw (drawBase, drawOver), locate rows (placeOf, rowAt), and may accept brushes (brushTo).
class Plot {
  constructor(box, store, { name, height = 330, margin = [10, 14, 46, 62] }) {
    this.store = store;
    this.name = name;
    this.height = height;
    [this.top, this.right, this.bottom, this.left] = margin;
    this.ratio = 1;
    this.order = null;
    this.box = document.createElement("div");
    this.box.className = "plot";
    this.box.tabIndex = 0;
    this.box.style.height = `${height}px`;
    this.box.setAttribute("role", "application");
    this.lower = document.createElement("canvas");
    this.lower.setAttribute("role", "img");
    this.upper = document.createElement("canvas");
    this.upper.setAttribute("aria-hidden", "true");
    this.box.append(this.lower, this.upper);
    box.append(this.box);
    this.base = this.lower.getContext("2d");
    this.over = this.upper.getContext("2d");
    this.listen();
    this.measure();
    new ResizeObserver(() => {
      if (this.measure()) this.redraw(new Set(["contents"]));
    }).observe(this.box);
    PRINTED.add(this);
  }

  // Whether the size changed.
  measure(ratio = Math.min(3, window.devicePixelRatio || 1)) {
    const width = this.box.clientWidth;
    if (width === this.width && ratio === this.ratio) return false;
    this.width = width;
    this.ratio = ratio;
    for (const canvas of [this.lower, this.upper]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(this.height * ratio);
    }
    return width > 0;
  }

  // A newly measured canvas is empty; in print, clearing it again would blank what lies below.
  redraw(events, empty = false) {
    if (!this.width) return;
    if (["contents", "shown", "options", "theme"].some((one) => events.has(one))) {
      this.base.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      if (!empty) this.base.clearRect(0, 0, this.width, this.height);
      this.order = null;
      this.drawBase(this.base);
      if (!this.store.shownCount) this.tellEmpty(this.base);
      this.lower.setAttribute("aria-label", this.summary());
      this.box.setAttribute("aria-label", `${this.title()}: arrow keys walk through the scenarios, Enter selects`);
    }
    this.over.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (!empty) this.over.clearRect(0, 0, this.width, this.height);
    this.drawOver(this.over);
  }

  tellEmpty(g) {
    g.font = `13px ${themeColours().font}`;
    g.fillStyle = themeColours().text;
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.fillText(fitted(g, "The filters leave no scenario.", this.width - 20), this.width / 2, this.height / 2);
  }

  title() {
    return this.name;
  }

  summary() {
    return `${this.title()}, ${this.store.shownCount} of ${this.store.n} scenarios shown`;
  }

  scaleX(low, high, choices) {
    this.x = new Scale(low, high, this.left, this.width - this.right, choices);
  }

  scaleY(low, high, choices) {
    this.y = new Scale(low, high, this.height - this.bottom, this.top, choices);
  }

  // Grid, ticks and labels of both axes.
  drawAxes(g, xTitle, yTitle) {
    const colours = themeColours();
    g.font = `11.5px ${colours.font}`;
    g.lineWidth = 1;
    g.strokeStyle = colours.grid;
    g.fillStyle = colours.faint;
    const bottom = this.height - this.bottom;
    g.textAlign = "center";
    g.textBaseline = "top";
    for (const [value, text] of this.x.ticks(this.x.choices.length ? 90 : 65)) {
      const at = Math.round(this.x.at(value)) + 0.5;
      line(g, at, this.top, at, bottom);
      g.fillText(text, at, bottom + 6);
    }
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (const [value, text] of this.y.ticks(this.y.choices.length ? 18 : 42)) {
      const at = Math.round(this.y.at(value)) + 0.5;
      line(g, this.left, at, this.width - this.right, at);
      g.fillText(text, this.left - 6, at);
    }
    g.fillStyle = colours.text;
    g.font = `12.5px ${colours.font}`;
    g.textAlign = "center";
    g.textBaseline = "bottom";
    const wide = this.width - this.left - this.right;
    g.fillText(fitted(g, xTitle, wide), this.left + wide / 2, this.height - 4);
    g.save();
    g.translate(4, (this.top + bottom) / 2);
    g.rotate(-Math.PI / 2);
    g.textBaseline = "top";
    g.fillText(fitted(g, yTitle, bottom - this.top), 0, 0);
    g.restore();
  }

  // The selected and hovered scenarios, as lines on top.
  markLines(g, draw, width, dash) {
    const { store } = this;
    const colours = themeColours();
    const marked = [[store.rows.get(store.selected), []], [store.rows.get(store.beside), dash], [store.hovered, []]];
    for (const [row, dashes] of marked) {
      if (row === undefined || row === null) continue;
      g.setLineDash([]);
      g.lineWidth = 5;
      g.strokeStyle = colours.raised;
      draw(row);
      g.setLineDash(dashes);
      g.lineWidth = width;
      g.strokeStyle = row === store.hovered ? colours.faint : colours.text;
      draw(row);
    }
    g.setLineDash([]);
  }

  inside(x, y) {
    return x >= this.left - 4 && x <= this.width - this.right + 4 && y >= this.top - 4 &&
      y <= this.height - this.bottom + 4;
  }

  listen() {
    let start = null;
    let drag = false;
    const place = (event) => {
      const box = this.box.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      start = place(event);
      drag = false;
    });
    this.box.addEventListener("pointermove", (event) => {
      const now = place(event);
      if (start !== null && this.brushTo && (drag || Math.hypot(now[0] - start[0], now[1] - start[1]) > 4)) {
        if (!drag) {
          this.box.setPointerCapture(event.pointerId);
          this.store.hover(null);
        }
        drag = true;
        tip().hide();
        this.brushTo(start, now);
        return;
      }
      this.hoverAt(...now, event);
    });
    this.box.addEventListener("pointerup", (event) => {
      if (start !== null && !drag) this.click(this.rowAt(...place(event)), event);
      start = null;
    });
    this.box.addEventListener("pointercancel", () => (start = null));
    this.box.addEventListener("pointerleave", () => {
      tip().hide();
      this.store.hover(null);
    });
    this.box.addEventListener("blur", () => {
      tip().hide();
      this.store.hover(null);
    });
    this.box.addEventListener("keydown", (event) => this.key(event));
  }

  hoverAt(x, y, event) {
    const row = this.rowAt(x, y);
    this.store.hover(row);
    if (row === null) tip().hide();
    else tip().showScenario(this.store, row, event.clientX, event.clientY);
  }

  click(row, event) {
    if (row === null) this.clearBrush?.();
    else chooseRow(this.store, row, event);
  }

  key(event) {
    const { store } = this;
    if (event.altKey || event.metaKey) return;
    if (event.key === "Escape") {
      tip().hide();
      if (store.hovered === null) this.clearBrush?.();
      store.hover(null);
    } else if ((event.key === "Enter" || event.key === " ") && store.hovered !== null) {
      chooseRow(store, store.hovered, event);
    } else if (["ArrowRight", "ArrowLeft", "ArrowUp", "ArrowDown", "Home", "End"].includes(event.key)) {
      this.walk(event.key);
    } else {
      return;
    }
    event.preventDefault();
  }

  // Moves to the next visible scenario, from left to right, or from bottom to top.
  walk(key) {
    const along = key === "ArrowUp" || key === "ArrowDown" ? 1 : 0;
    if (this.order?.along !== along) this.order = { along, rows: this.rowsInOrder(along) };
    const { rows } = this.order;
    if (!rows.length) return announce("No scenario is shown.");
    const { store } = this;
    const from = store.hovered ?? (store.selected === null ? null : store.rows.get(store.selected));
    let at = from === null ? -1 : rows.indexOf(from);
    if (key === "Home") at = 0;
    else if (key === "End") at = rows.length - 1;
    else if (at < 0) at = 0;
    else at += key === "ArrowRight" || key === "ArrowUp" ? 1 : -1;
    const row = rows[Math.max(0, Math.min(rows.length - 1, at))];
    store.hover(row);
    const place = this.placeOf(row);
    const box = this.box.getBoundingClientRect();
    if (place !== null) tip().showScenario(store, row, box.left + place[0], box.top + place[1]);
    announce(sayScenario(store, row));
  }

  rowsInOrder(along) {
    const rows = [];
    const places = new Map();
    for (let row = 0; row < this.store.n; row++) {
      const place = this.store.shown[row] ? this.placeOf(row) : null;
      if (place === null) continue;
      rows.push(row);
      places.set(row, along ? -place[1] : place[0]);
    }
    return rows.sort((one, other) => places.get(one) - places.get(other) || one - other);
  }
}

// Drawings that are redrawn in print resolution.
const PRINTED = new Set();

// A click selects; with Shift, Ctrl or Cmd the scenario is shown beside the selected one.
function chooseRow(store, row, event) {
  const slot = event.shiftKey || event.ctrlKey || event.metaKey ? "beside" : "selected";
  const id = store.contents.scenarios.id[row];
  store.select(id, slot);
  announce(slot === "beside" ? `Scenario ${id} is beside it` : `Scenario ${id} is selected`);
}

function line(g, x0, y0, x1, y1) {
  g.beginPath();
  g.moveTo(x0, y0);
  g.lineTo(x1, y1);
  g.stroke();
}

// The text, shortened to the available width.
function fitted(g, text, width) {
  if (g.measureText(text).width <= width) return text;
  const letters = Array.from(text);
  while (letters.length > 4 && g.measureText(`${letters.join("")}…`).width > width) letters.pop();
  return `${letters.join("")}…`;
}
