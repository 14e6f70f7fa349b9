"use strict";

// Symbols around a point, all of the same apparent size as the circle.
function symbolPath(g, symbol, x, y, r) {
  g.beginPath();
  const corners = (count, size, turn, inner = null) => {
    const all = inner === null ? count : 2 * count;
    for (let k = 0; k < all; k++) {
      const angle = turn + (2 * Math.PI * k) / all;
      const far = inner !== null && k % 2 ? size * inner : size;
      g.lineTo(x + far * Math.sin(angle), y - far * Math.cos(angle));
    }
    g.closePath();
  };
  if (symbol === "square") g.rect(x - 0.86 * r, y - 0.86 * r, 1.72 * r, 1.72 * r);
  else if (symbol === "triangle") corners(3, 1.3 * r, 0);
  else if (symbol === "down") corners(3, 1.3 * r, Math.PI);
  else if (symbol === "diamond") corners(4, 1.3 * r, 0);
  else if (symbol === "pentagon") corners(5, 1.1 * r, 0);
  else if (symbol === "star") corners(5, 1.45 * r, 0, 0.45);
  else if (symbol === "plus") {
    const w = 0.36 * r;
    const l = 1.2 * r;
    for (const [a, b] of [[w, l], [w, w], [l, w], [l, -w], [w, -w], [w, -l], [-w, -l], [-w, -w], [-l, -w], [-l, w],
      [-w, w], [-w, l]]) g.lineTo(x + a, y + b);
    g.closePath();
  } else g.arc(x, y, r, 0, 7);
}

function drawSymbol(g, { colour, symbol }, x, y, r) {
  if (symbol === "cross") {
    g.strokeStyle = colour;
    g.lineWidth = Math.max(1.3, r / 2.2);
    line(g, x - r, y - r, x + r, y + r);
    line(g, x - r, y + r, x + r, y - r);
    return;
  }
  symbolPath(g, symbol, x, y, r);
  if (symbol === "ring") {
    g.strokeStyle = colour;
    g.lineWidth = 1.3;
    g.stroke();
  } else {
    g.fillStyle = colour;
    g.fill();
  }
}

// Scenarios as points: a plot that knows their positions (px, py: one per row, NaN for none).
class PointPlot extends Plot {
  radius() {
    const { n } = this.store;
    return n > 5000 ? 1.8 : n > 1200 ? 2.6 : 3.6;
  }

  drawPoints(g, px, py, order = drawingOrder(this.store)) {
    this.px = px;
    this.py = py;
    const { store, ratio } = this;
    const looks = rowLooks(store);
    const { scenarios } = store.contents;
    const r = this.radius();
    this.raster ??= new Raster();
    this.raster.begin(this.lower.width, this.lower.height);
    const stamp = (row, style, radius = r) => {
      if (px[row] > -1e6) this.raster.put(STAMPS.get(style, radius, ratio), px[row] * ratio, py[row] * ratio);
    };
    const ghost = { colour: themeColours().ghost, symbol: "circle" };
    for (let row = 0; row < store.n; row++) if (!store.shown[row]) stamp(row, ghost, r * 0.75);
    const cross = { colour: themeColours().danger, symbol: "cross" };
    for (const row of order) {
      if (!store.shown[row]) continue;
      if (scenarios.failed[row]) stamp(row, cross);
      else stamp(row, looks.styles[looks.of[row]]);
    }
    this.raster.end(g);
    for (let row = 0; row < store.n; row++) {
      if (!scenarios.kept[row] || !store.shown[row] || !(px[row] > -1e6)) continue;
      drawKept(g, looks.styles[looks.of[row]], keptRole(store, row), px[row], py[row], Math.max(3, r));
    }
  }

  placeOf(row) {
    return this.px && this.px[row] > -1e6 ? [this.px[row], this.py[row]] : null;
  }

  rowAt(x, y, reach = 12) {
    const { px, py, store } = this;
    if (!px) return null;
    let found = null;
    let nearest = reach * reach;
    for (let row = 0; row < store.n; row++) {
      const distance = (px[row] - x) ** 2 + (py[row] - y) ** 2;
      if (distance <= nearest && store.shown[row]) {
        nearest = distance;
        found = row;
      }
    }
    return found;
  }

  drawMarks(g) {
    const { store } = this;
    for (const [id, dash] of [[store.selected, []], [store.beside, [3, 3]]]) {
      const place = id === null ? null : this.placeOf(store.rows.get(id));
      if (place === null) continue;
      g.setLineDash([]);
      g.lineWidth = 6;
      g.strokeStyle = themeColours().raised;
      g.beginPath();
      g.arc(...place, 11, 0, 7);
      g.stroke();
      g.setLineDash(dash);
      g.lineWidth = 3.2;
      g.strokeStyle = themeColours().text;
      g.stroke();
    }
    g.setLineDash([]);
    if (store.hovered !== null) {
      const place = this.placeOf(store.hovered);
      if (place === null) return;
      g.lineWidth = 2;
      g.strokeStyle = themeColours().text;
      g.beginPath();
      g.arc(...place, 7, 0, 7);
      g.stroke();
    }
  }
}

const ROLES = {
  prototype: ["star", 2.9], "critical prototype": ["plus", 2.7], archetype: ["circle", 1.95], gap: ["triangle", 2.4],
};

function keptRole(store, row) {
  return store.contents.kept[store.contents.scenarios.id[row]]?.role ?? "kept";
}

// A scenario of the reduced set keeps the style of its kind, with an outline for its role.
function drawKept(g, style, role, x, y, r) {
  const [outline, size] = (Object.hasOwn(ROLES, role) ? ROLES[role] : ["diamond", 2.2]);
  symbolPath(g, outline, x, y, size * r);
  g.fillStyle = themeColours().raised;
  g.globalAlpha = 0.75;
  g.fill();
  g.globalAlpha = 1;
  g.strokeStyle = themeColours().text;
  g.lineWidth = 1.3;
  g.stroke();
  drawSymbol(g, style.symbol === "ring" ? { ...style, symbol: "circle" } : style, x, y, r * 0.95);
}

// Rows in drawing order: the most critical ones last, and so on top.
function drawingOrder(store) {
  const key = `${store.version} ${store.options.metric}`;
  if (store.drawing?.key !== key) {
    const scores = store.column(`score ${store.options.metric}`);
    const sign = store.metricOf().lower_is_critical ? -1 : 1;
    const keys = Float64Array.from(scores, (one) => (Number.isNaN(one) ? -Infinity : sign * one));
    const rows = Uint32Array.from(keys, (_, row) => row).sort((one, other) => keys[one] - keys[other] || one - other);
    store.drawing = { key, rows };
  }
  return store.drawing.rows;
}
