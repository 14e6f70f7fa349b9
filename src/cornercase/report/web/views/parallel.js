"use strict";

// Each scenario is a line across the axes of all parameters and the score.
const MOST_AXES = 12;
const MOST_LINES = 1500;

class ParallelPlot extends Plot {
  constructor(box, store) {
    super(box, store, { name: "parallel", height: 340, margin: [34, 48, 40, 48] });
    this.drawn = [];
  }

  title() {
    return "Parallel coordinates of the parameters and the score";
  }

  columns() {
    const { store } = this;
    const varied = store.contents.parameters.filter((one) => one.choices.length > 1 || one.low !== one.high);
    const names = varied.slice(0, MOST_AXES - 1).map((one) => `parameter ${one.name}`);
    return [...names, `score ${store.options.metric}`];
  }

  drawBase(g) {
    const { store } = this;
    const names = this.columns();
    const wide = this.width - this.left - this.right;
    this.axes = names.map((name, k) => {
      const axis = store.axis(name);
      const scale = new Scale(...columnRange(store, name), this.height - this.bottom, this.top, axis.choices);
      return { name, axis, scale, at: this.left + (wide * k) / (names.length - 1), values: store.column(name) };
    });
    const looks = rowLooks(store);
    g.lineWidth = 1;
    const hidden = evenly(rowsWhere(store, (row) => !store.shown[row]), MOST_LINES / 3);
    this.drawn = evenly(drawingOrder(store).filter((row) => store.shown[row]), MOST_LINES);
    g.globalAlpha = 0.5;
    g.strokeStyle = themeColours().ghost;
    for (const row of hidden) this.drawLine(g, row);
    g.globalAlpha = Math.max(0.25, Math.min(0.8, 60 / Math.sqrt(this.drawn.length * 10 + 1)));
    for (const row of this.drawn) {
      const { colour, label } = looks.styles[looks.of[row]];
      g.strokeStyle = store.contents.scenarios.failed[row] ? themeColours().danger : colour;
      g.setLineDash(label > 0 ? DASHES[label % DASHES.length] : []);
      this.drawLine(g, row);
    }
    g.setLineDash([]);
    g.globalAlpha = 1;
    this.drawScales(g);
  }

  drawScales(g) {
    const colours = themeColours();
    const apart = this.axes.length > 1 ? this.axes[1].at - this.axes[0].at : this.width;
    this.axes.forEach(({ axis, scale, at }, k) => {
      g.strokeStyle = colours.faint;
      g.lineWidth = 1;
      line(g, Math.round(at) + 0.5, this.top, Math.round(at) + 0.5, this.height - this.bottom);
      g.font = `11px ${colours.font}`;
      g.textAlign = "left";
      g.textBaseline = "middle";
      for (const [value, text] of scale.ticks(55)) {
        const y = scale.at(value);
        line(g, at - 3, y, at + 4, y);
        g.lineWidth = 5;
        g.strokeStyle = colours.raised;
        const said = fitted(g, text, apart - 12);
        g.strokeText(said, at + 6, y);
        g.fillStyle = colours.text;
        g.fillText(said, at + 6, y);
        g.lineWidth = 1;
        g.strokeStyle = colours.faint;
      }
      g.fillStyle = colours.text;
      g.font = `12px ${colours.font}`;
      // The outermost labels grow inwards.
      const last = k === this.axes.length - 1;
      g.textAlign = k === 0 ? "left" : last ? "right" : "center";
      g.textBaseline = "alphabetic";
      // Neighbouring labels alternate above and below if a row is too narrow.
      const low = apart < 130 && k % 2 === 1;
      const room = (apart < 130 ? 2 : 1) * apart - 10;
      const place = k === 0 ? 4 : last ? this.width - 4 : at;
      const height = low ? this.height - this.bottom + 24 : this.top - 14;
      g.fillText(fitted(g, axis.title, Math.max(room, 60)), place, height);
    });
  }

  drawLine(g, row) {
    g.beginPath();
    for (const { at, scale, values } of this.axes) {
      if (Number.isFinite(values[row])) g.lineTo(at, scale.at(values[row]));
    }
    g.stroke();
  }

  drawOver(g) {
    if (!this.axes) return;
    const { store } = this;
    const colours = themeColours();
    for (const { name, scale, at } of this.axes) {
      const range = store.ranges.get(name);
      if (!range) continue;
      const [low, high] = range.map((value) => scale.at(Math.max(scale.low, Math.min(scale.high, value))));
      g.fillStyle = colours.accent;
      g.globalAlpha = 0.25;
      g.fillRect(at - 7, high, 14, low - high);
      g.globalAlpha = 1;
      g.strokeStyle = colours.accent;
      g.strokeRect(at - 7, high, 14, low - high);
    }
    this.markLines(g, (row) => this.drawLine(g, row), 2.4, [5, 4]);
  }

  placeOf(row) {
    const { at, scale, values } = this.axes[this.axes.length - 1];
    return Number.isFinite(values[row]) ? [at, scale.at(values[row])] : null;
  }

  rowAt(x, y) {
    if (!this.axes) return null;
    const k = Math.max(0, Math.min(this.axes.length - 2, this.axes.findLastIndex(({ at }) => at <= x)));
    const [one, other] = [this.axes[k], this.axes[k + 1]];
    const share = (x - one.at) / (other.at - one.at);
    let found = null;
    let nearest = 7;
    for (const row of this.drawn) {
      const [from, to] = [one.scale.at(one.values[row]), other.scale.at(other.values[row])];
      const distance = Math.abs(from + share * (to - from) - y);
      if (distance < nearest) [nearest, found] = [distance, row];
    }
    return found;
  }

  axisAt(x) {
    return this.axes.reduce((one, other) => (Math.abs(other.at - x) < Math.abs(one.at - x) ? other : one));
  }

  brushTo([x0, y0], [, y1]) {
    const { name, scale } = this.axisAt(x0);
    const range = [scale.value(y0), scale.value(y1)].sort((one, other) => one - other);
    this.store.setRanges([[name, ...range]]);
  }

  clearBrush() {
    const names = this.columns().filter((name) => this.store.ranges.has(name));
    if (names.length) this.store.setRanges(names.map((name) => [name, null, null]));
  }
}

function rowsWhere(store, test) {
  const rows = [];
  for (let row = 0; row < store.n; row++) if (test(row)) rows.push(row);
  return rows;
}

// At most this many of them, evenly picked, in their order.
function evenly(rows, most) {
  if (rows.length <= most) return Array.from(rows);
  return Array.from({ length: Math.floor(most) }, (_, k) => rows[Math.floor((k * rows.length) / Math.floor(most))]);
}

function tellPicked(drawn, shown) {
  return drawn < shown ? `${drawn} of the ${shown} scenarios are drawn, evenly picked.` : "";
}

VIEWS.push({
  name: "parallel",
  title: "All parameters",
  wide: true,
  about: "Each line is a scenario.",
  more: "Each line is a scenario. Drag along an axis to keep a range of it; click a line to see the scenario move.",
  wanted: (store) => store.contents.parameters.length >= 4,
  create(box, store) {
    const plot = new ParallelPlot(box, store);
    plot.box.style.touchAction = "pan-x pinch-zoom";
    const legend = document.createElement("ul");
    legend.className = "legend";
    const note = document.createElement("p");
    note.className = "note";
    box.append(legend, note);
    const menu = rangeMenu(box, store, () => plot.columns());
    return {
      plot,
      redraw(events) {
        plot.redraw(events);
        if (onlyMarks(events)) return;
        fillLegend(legend, store, legendLine);
        note.textContent = tellPicked(plot.drawn.length, store.shownCount);
        menu();
      },
    };
  },
});
