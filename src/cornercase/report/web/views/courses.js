"use strict";

// Courses of the metric over time: a line for each of some scenarios, and a band for each kind.
const MOST_COURSES = 200;
const MOST_IN_BAND = 400;
const MOST_BANDS = 6;
const INSTANTS = 80;
const NOTHING = 65535;

class CoursesPlot extends Plot {
  constructor(box, store) {
    super(box, store, { name: "courses" });
    this.drawn = [];
    this.bands = [];
  }

  title() {
    return `${this.store.axis(`score ${this.store.options.metric}`).title} over time`;
  }

  // The packed courses of the metric; nothing is drawn until they are unpacked.
  courses() {
    const all = this.store.contents.courses[this.store.options.metric];
    if (!all) return null;
    if (typeof all.values !== "string") return all;
    if (this.awaited !== all) {
      this.awaited = all;
      unpackCourses(all).then(() => {
        this.redraw(new Set(["contents"]));
        this.done?.();
      });
    }
    return null;
  }

  value(all, row, time) {
    const { points, begin, end, values, low, high } = all;
    if (values[row * points] === NOTHING || time < begin[row] || time > end[row]) return NaN;
    const place = end[row] > begin[row] ? ((time - begin[row]) / (end[row] - begin[row])) * (points - 1) : 0;
    const k = Math.min(points - 2, Math.floor(place));
    const one = values[row * points + k];
    const number = one + (place - k) * (values[row * points + k + 1] - one);
    return low + (number / (NOTHING - 1)) * (high - low);
  }

  drawBase(g) {
    const { store } = this;
    const all = this.courses();
    this.drawn = [];
    this.bands = [];
    if (all === null) return;
    this.all = all;
    const there = (row) => all.values[row * all.points] !== NOTHING;
    const shown = Array.from(drawingOrder(store)).filter((row) => store.shown[row] && there(row));
    const times = [0, 1];
    for (let row = 0; row < store.n; row++) if (there(row)) times.push(all.end[row]);
    this.scaleX(Math.min(0, ...all.begin.slice(0, 1)), times.reduce((one, other) => Math.max(one, other)), []);
    this.scaleY(all.low, all.high, []);
    this.drawAxes(g, "time [s]", store.axis(`score ${store.options.metric}`).title);
    const looks = rowLooks(store);
    this.drawn = evenly(shown, MOST_COURSES);
    g.lineWidth = 1;
    g.globalAlpha = Math.max(0.16, Math.min(0.6, 14 / Math.sqrt(10 * this.drawn.length + 1)));
    for (const row of this.drawn) {
      g.strokeStyle = looks.styles[looks.of[row]].colour;
      this.drawCourse(g, row);
    }
    g.globalAlpha = 1;
    this.drawBands(g, shown);
    const threshold = store.threshold();
    if (threshold !== null) drawThreshold(g, this, null, `score ${store.options.metric}`);
  }

  drawCourse(g, row) {
    const { points, begin, end, values, low, high } = this.all;
    g.beginPath();
    for (let k = 0; k < points; k++) {
      const number = values[row * points + k];
      if (number === NOTHING) return;
      const time = begin[row] + ((end[row] - begin[row]) * k) / (points - 1);
      g.lineTo(this.x.at(time), this.y.at(low + (number / (NOTHING - 1)) * (high - low)));
    }
    g.stroke();
  }

  drawBands(g, shown) {
    const { store } = this;
    const groups = new Map();
    for (const row of shown) {
      const label = store.kindOf(row);
      if (label !== null && label < 0) continue;
      if (!groups.has(label)) groups.set(label, []);
      groups.get(label).push(row);
    }
    const most = [...groups].filter(([, rows]) => rows.length >= 5);
    most.sort((one, other) => other[1].length - one[1].length);
    this.bandless = groups.size - Math.min(most.length, MOST_BANDS);
    for (const [label, rows] of most.slice(0, MOST_BANDS)) {
      const band = this.band(evenly(rows, MOST_IN_BAND / Math.min(most.length, MOST_BANDS)));
      const colour = store.options.colour === "kind" && label !== null ? kindColour(label) : themeColours().accent;
      this.bands.push({ label, count: rows.length, colour });
      g.fillStyle = colour;
      g.globalAlpha = 0.16;
      g.beginPath();
      for (const { time, high } of band) g.lineTo(this.x.at(time), this.y.at(high));
      for (const { time, low } of band.toReversed()) g.lineTo(this.x.at(time), this.y.at(low));
      g.fill();
      g.globalAlpha = 1;
      for (const [width, stroke, dash] of [[4.5, themeColours().raised, []], [2.2, colour, DASHES[(label ?? 0) % 4]]]) {
        g.lineWidth = width;
        g.strokeStyle = stroke;
        g.setLineDash(dash);
        g.beginPath();
        for (const { time, middle } of band) g.lineTo(this.x.at(time), this.y.at(middle));
        g.stroke();
      }
      g.setLineDash([]);
    }
  }

  // Median, 10th and 90th percentile while at least half of the scenarios still run.
  band(rows) {
    const { all } = this;
    const end = rows.reduce((most, row) => Math.max(most, all.end[row]), 0);
    const found = [];
    for (let k = 0; k < INSTANTS; k++) {
      const time = (end * k) / (INSTANTS - 1);
      const run = Float64Array.from(rows, (row) => this.value(all, row, time));
      const values = run.filter((one) => !Number.isNaN(one)).sort();
      if (values.length < Math.max(1, rows.length / 2)) continue;
      const at = (share) => values[Math.round(share * (values.length - 1))];
      found.push({ time, low: at(0.1), middle: at(0.5), high: at(0.9) });
    }
    return found;
  }

  drawOver(g) {
    if (!this.all || !this.x) return;
    this.markLines(g, (row) => this.drawCourse(g, row), 2.8, [6, 4]);
  }

  placeOf(row) {
    const value = this.store.column(`score ${this.store.options.metric}`)[row];
    const there = this.all && this.all.values[row * this.all.points] !== NOTHING;
    if (!there || !Number.isFinite(value)) return null;
    return [this.x.at(this.all.end[row]), this.y.at(this.value(this.all, row, this.all.end[row]))];
  }

  rowAt(x, y) {
    if (!this.all || !this.inside(x, y)) return null;
    const time = this.x.value(x);
    let found = null;
    let nearest = 8;
    for (const row of this.drawn) {
      const distance = Math.abs(this.y.at(this.value(this.all, row, time)) - y);
      if (distance < nearest) [nearest, found] = [distance, row];
    }
    return found;
  }
}

VIEWS.push({
  name: "courses",
  title: "Courses over time",
  about: (store) => `Thick: the median${store.options.aspect === null ? "" : " of each kind"}.`,
  more: (store) => {
    const kinds = store.options.aspect === null ? "of all shown" : "of each kind";
    const line = store.threshold() === null ? "" : " A dashed line is where critical begins.";
    const { metric } = store.options;
    const { cap, unit, lower_is_critical: lower } = store.contents.metrics.find((one) => one.name === metric);
    const beyond = `What is ${lower ? "above" : "below"} ${withUnit(cap, unit)} or not defined is drawn at ${withUnit(cap, unit)}.`;
    return `${metric} over time in each scenario. Thick: the median ${kinds}, with the band that holds 80 %.${line} ${beyond}`;
  },
  wanted: (store) => Object.keys(store.contents.courses ?? {}).length > 0,
  create(box, store) {
    const plot = new CoursesPlot(box, store);
    const legend = document.createElement("ul");
    legend.className = "legend";
    const note = document.createElement("p");
    note.className = "note";
    box.append(legend, note);
    plot.done = () => {
      const items = plot.bands.map(({ label, count, colour }) => {
        const item = document.createElement("li");
        item.append(lineSample(colour, DASHES[(label ?? 0) % 4]));
        item.append(`${label === null ? "all shown" : unturned(store.kindName(label))} (${count})`);
        return item;
      });
      legend.replaceChildren(...items);
      const picked = plot.drawn.length === MOST_COURSES ? tellPicked(MOST_COURSES, store.shownCount) : "";
      const others = !plot.bandless ? "" : plot.bandless === 1
        ? "One smaller group has no median here." : `${plot.bandless} smaller groups have no median here.`;
      note.textContent = `${picked} ${others}`.trim();
    };
    return {
      plot,
      redraw(events) {
        plot.redraw(events);
        if (!onlyMarks(events)) plot.done();
      },
    };
  },
});

function lineSample(colour, dash) {
  const canvas = document.createElement("canvas");
  canvas.width = 52;
  canvas.height = 28;
  canvas.style.width = "26px";
  const g = canvas.getContext("2d");
  g.scale(2, 2);
  g.strokeStyle = colour;
  g.lineWidth = 2.4;
  g.setLineDash(dash);
  line(g, 0, 7, 26, 7);
  return canvas;
}
