"use strict";

// Number of scenarios by score.
class HistogramPlot extends Plot {
  constructor(box, store) {
    super(box, store, { name: "histogram" });
    this.bars = [];
  }

  title() {
    return `Number of scenarios by ${this.store.axis(this.column()).title}`;
  }

  summary() {
    const { bars } = this;
    if (!bars.length) return `${this.title()}: no scenario has a score`;
    const largest = bars.reduce((one, other) => (other.all > one.all ? other : one));
    const { unit } = this.store.metricOf();
    return (
      `${this.title()}, ${this.store.shownCount} of ${this.store.n} shown; most, ${largest.all}, lie between ` +
      `${formatNumber(largest.low)} and ${withUnit(largest.high, unit)}`
    );
  }

  column() {
    return `score ${this.store.options.metric}`;
  }

  count() {
    const { store } = this;
    const values = store.column(this.column());
    const [low, high] = finiteRange(values);
    const most = Math.max(8, Math.min(40, Math.round(2 * Math.cbrt(store.n) * 1.3)));
    const step = (high - low) / most || 1;
    // No bar is partly critical: the threshold lies between two of them.
    const threshold = store.threshold();
    const within = threshold !== null && threshold > low && threshold < high;
    const from = within ? threshold - Math.ceil((threshold - low) / step) * step : low;
    const last = from < low ? most : most - 1;
    const bar = (k) => ({ low: from + k * step, high: from + (k + 1) * step, all: 0, shown: 0 });
    this.bars = Array.from({ length: last + 1 }, (_, k) => bar(k));
    for (let row = 0; row < store.n; row++) {
      if (!Number.isFinite(values[row])) continue;
      const bar = this.bars[Math.max(0, Math.min(last, Math.floor((values[row] - from) / step)))];
      bar.all += 1;
      bar.shown += store.shown[row];
    }
    return [from, from + (last + 1) * step];
  }

  drawBase(g) {
    const [low, high] = this.count();
    const { store } = this;
    this.scaleX(low, high, []);
    const greatest = Math.max(1, ...this.bars.map((bar) => bar.all));
    this.scaleY(0, greatest, []);
    this.y.low = 0;
    this.drawAxes(g, store.axis(this.column()).title, "number of scenarios [1]");
    const colours = themeColours();
    for (const bar of this.bars) {
      const [left, right] = [this.x.at(bar.low) + 0.5, this.x.at(bar.high) - 0.5];
      for (const [count, colour] of [[bar.all, colours.ghost], [bar.shown, colours.accent]]) {
        g.fillStyle = colour;
        g.fillRect(left, this.y.at(count), Math.max(1, right - left), this.y.at(0) - this.y.at(count));
      }
    }
    drawThreshold(g, this, this.column(), null);
  }

  drawOver(g) {
    const { store } = this;
    const range = store.ranges.get(this.column());
    const colours = themeColours();
    if (range) {
      const [left, right] = range.map((value, k) =>
        Number.isFinite(value) ? this.x.at(value) : k ? this.width - this.right : this.left);
      g.fillStyle = colours.accent;
      g.globalAlpha = 0.1;
      g.fillRect(left, this.top, right - left, this.height - this.bottom - this.top);
      g.globalAlpha = 1;
      g.strokeStyle = colours.accent;
      g.strokeRect(left, this.top, right - left, this.height - this.bottom - this.top);
    }
    const marks = [[store.selected, [], colours.text], [store.beside, [3, 3], colours.text]];
    for (const [id, dash, colour] of marks) if (id !== null) this.drawMark(g, store.rows.get(id), dash, colour);
    if (store.hovered !== null) this.drawMark(g, store.hovered, [], colours.faint);
    g.setLineDash([]);
  }

  drawMark(g, row, dash, colour) {
    const place = this.placeOf(row);
    if (place === null) return;
    g.setLineDash(dash);
    g.strokeStyle = colour;
    g.lineWidth = 2;
    line(g, place[0], this.top, place[0], this.height - this.bottom);
  }

  placeOf(row) {
    const value = this.store.column(this.column())[row];
    return Number.isFinite(value) ? [this.x.at(value), this.y.at(0) - 8] : null;
  }

  rowAt() {
    return null;
  }

  hoverAt(x, y, event) {
    const value = this.x.value(x);
    const bar = this.inside(x, y) ? this.bars.find((one) => value >= one.low && value < one.high) : undefined;
    if (!bar) return tip().hide();
    const { unit } = this.store.metricOf();
    const title = `${formatNumber(bar.low)} to ${withUnit(bar.high, unit)}`;
    tip().show(title, [["shown", String(bar.shown)], ["of all", String(bar.all)]], event.clientX, event.clientY);
  }

  brushTo([x0], [x1]) {
    const range = [this.x.value(x0), this.x.value(x1)].sort((one, other) => one - other);
    this.store.setRanges([[this.column(), ...range]]);
  }

  clearBrush() {
    if (this.store.ranges.has(this.column())) this.store.setRanges([[this.column(), null, null]]);
  }
}

VIEWS.push({
  name: "histogram",
  title: "Scores",
  about: "How many scenarios have which score.",
  more: (store) => {
    const { name, lower_is_critical: low } = store.metricOf();
    const line = store.threshold() === null ? "" : " A dashed line is where critical begins.";
    return `Number of scenarios by ${name}; ${low ? "low" : "high"} is critical.${line} Drag to keep a range.`;
  },
  finding: true,
  wanted: () => true,
  create(box, store) {
    const plot = new HistogramPlot(box, store);
    return { plot, redraw: (events) => plot.redraw(events) };
  },
});
