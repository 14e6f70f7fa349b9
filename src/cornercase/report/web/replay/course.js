"use strict";

// Courses over time in the scenarios of the replay: the ego's speed and acceleration, the gap to the other, and the
// metric with its threshold; marks of events above them, and one cursor at the clock's time.

const COURSE_EDGES = { left: 42, right: 10, top: 4, bottom: 32 };
// Heights in pixels of a course with its title, of the title, and of a line of event marks.
const COURSE_HEIGHT = 78;
const COURSE_TITLE = 16;
const EVENTS_HEIGHT = 18;
// Distance in pixels within which a click means a mark.
const MARK_REACH = 9;
// Larger gaps in m are beyond the axis: what matters are the last metres.
const LARGEST_GAP = 50;

// About three to six round numbers between two values.
function roundTicks(low, high, most = 5) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(span / most));
  const step = power * [1, 2, 5, 10].find((one) => span / (power * one) <= most);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) ticks.push(k * step);
  return ticks;
}

function tickText(value) {
  return String(Number(value.toPrecision(6)));
}

class CourseChart {
  // `seek(time)` is called on a click or drag.
  constructor(canvas, seek) {
    this.canvas = canvas;
    // An empty chart, as one recording may be drawn before the other is read.
    this.setCourses([], 0, 1, []);
    let dragging = false;
    const seekTo = (event) => seek(this.timeAt(event.offsetX));
    canvas.addEventListener("pointerdown", (event) => {
      dragging = true;
      canvas.setPointerCapture(event.pointerId);
      const mark = this.markAt(event.offsetX, event.offsetY);
      if (mark) seek(mark.time);
      else seekTo(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      const mark = this.markAt(event.offsetX, event.offsetY);
      canvas.title = mark ? `${mark.text} at ${mark.time.toFixed(2)} s` : "";
      // A hand that trembles on a mark stays there.
      if (dragging && !mark) seekTo(event);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (dragging = false));
  }

  size() {
    return { width: this.canvas.clientWidth, height: this.canvas.clientHeight };
  }

  // Panels are { title, courses, threshold, low, high }, courses { slot, time, values }, and lines of events
  // { slot, events }; the threshold may be null, and the bounds of the axis may be missing.
  setCourses(panels, begin, end, lines) {
    Object.assign(this, { begin, end: Math.max(end, begin + 1e-3), lines: lines.filter((one) => one.events.length) });
    this.panels = panels.map((panel) => ({ ...panel, range: courseRange(panel) }));
    const { top, bottom } = COURSE_EDGES;
    const height = top + this.lines.length * EVENTS_HEIGHT + panels.length * COURSE_HEIGHT + bottom;
    this.canvas.style.height = `${height}px`;
  }

  across(time) {
    const { left, right } = COURSE_EDGES;
    return left + ((time - this.begin) / (this.end - this.begin)) * (this.size().width - left - right);
  }

  timeAt(x) {
    const { left, right } = COURSE_EDGES;
    const share = (x - left) / (this.size().width - left - right);
    return this.begin + Math.min(Math.max(share, 0), 1) * (this.end - this.begin);
  }

  // The mark of an event at a point of the canvas, or null.
  markAt(x, y) {
    const line = this.lines[Math.floor((y - COURSE_EDGES.top) / EVENTS_HEIGHT)];
    const away = (event) => Math.abs(this.across(event.time) - x);
    const near = (line?.events ?? []).filter((event) => away(event) <= MARK_REACH);
    return near.length ? near.reduce((best, event) => (away(event) < away(best) ? event : best)) : null;
  }

  draw(time, colours) {
    const { width, height } = this.size();
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.font = "11px system-ui, sans-serif";
    const { top, bottom } = COURSE_EDGES;
    const above = top + this.lines.length * EVENTS_HEIGHT;
    this.drawTimes(context, above, width, height, colours);
    this.drawEvents(context, height - bottom, colours);
    this.panels.forEach((panel, k) => this.drawPanel(context, panel, above + k * COURSE_HEIGHT, time, width, colours));
    context.strokeStyle = colours.label;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(this.across(time), top);
    context.lineTo(this.across(time), height - bottom);
    context.stroke();
  }

  drawTimes(context, above, width, height, colours) {
    const { left, right, bottom } = COURSE_EDGES;
    context.strokeStyle = colours.edge;
    context.fillStyle = colours.label;
    context.lineWidth = 1;
    context.globalAlpha = 0.4;
    context.beginPath();
    context.textAlign = "center";
    context.textBaseline = "top";
    const ticks = roundTicks(this.begin, this.end, Math.max(2, Math.floor(width / 60)));
    for (const tick of ticks) {
      context.moveTo(this.across(tick), height - bottom);
      context.lineTo(this.across(tick), height - bottom + 4);
    }
    context.stroke();
    context.globalAlpha = 1;
    for (const tick of ticks) context.fillText(tickText(tick), this.across(tick), height - bottom + 5);
    context.fillText("time [s]", (left + width - right) / 2, height - 13);
  }

  // Marks in a line for each scenario, and thin lines from there through all courses.
  drawEvents(context, low, colours) {
    const { left } = COURSE_EDGES;
    const width = this.size().width;
    this.lines.forEach(({ slot, events }, k) => {
      const y = COURSE_EDGES.top + (k + 0.5) * EVENTS_HEIGHT;
      context.strokeStyle = colours[slot];
      context.lineWidth = 1;
      context.globalAlpha = 0.5;
      context.setLineDash(slot === "beside" ? [5, 4] : []);
      context.beginPath();
      context.moveTo(left, y);
      context.lineTo(width - COURSE_EDGES.right, y);
      context.stroke();
      context.setLineDash([1, 3]);
      context.beginPath();
      for (const event of events) {
        context.moveTo(this.across(event.time), y);
        context.lineTo(this.across(event.time), low);
      }
      context.stroke();
      context.setLineDash([]);
      context.globalAlpha = 1;
      for (const { mark, time } of events) {
        drawEventMark(context, mark, this.across(time), y, mark === "star" ? colours.hit : colours[slot], colours.halo);
      }
    });
  }

  drawPanel(context, panel, top, time, width, colours) {
    const { left, right } = COURSE_EDGES;
    const [low, high] = panel.range;
    const [ceiling, floor] = [top + COURSE_TITLE, top + COURSE_HEIGHT - 4];
    const down = (v) => floor - ((v - low) / (high - low)) * (floor - ceiling);
    context.strokeStyle = colours.edge;
    context.fillStyle = colours.label;
    context.lineWidth = 1;
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.globalAlpha = 0.4;
    context.beginPath();
    const ticks = roundTicks(low, high, 4);
    for (const tick of ticks) {
      context.moveTo(left, down(tick));
      context.lineTo(width - right, down(tick));
    }
    context.stroke();
    context.globalAlpha = 1;
    for (const tick of ticks) context.fillText(tickText(tick), left - 5, down(tick));
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    context.fillText(panel.title, left, top + 11);
    context.save();
    context.beginPath();
    context.rect(left, ceiling - 2, width - left - right, floor - ceiling + 4);
    context.clip();
    if (panel.threshold !== null) drawThresholdLine(context, down(panel.threshold), left, width - right, colours);
    for (const course of panel.courses) drawCourse(context, course, (t) => this.across(t), down, colours);
    context.restore();
    let end = width - right;
    for (const course of [...panel.courses].reverse()) {
      const value = between(course.values, momentOf(course.time, time));
      if (!Number.isFinite(value)) continue;
      context.fillStyle = colours[course.slot];
      if (value >= low && value <= high) {
        context.beginPath();
        context.arc(this.across(Math.min(time, course.time[course.time.length - 1])), down(value), 3.5, 0, 2 * Math.PI);
        context.fill();
      }
      context.textAlign = "right";
      const text = value.toFixed(2);
      context.fillText(text, end, top + 11);
      end -= context.measureText(text).width + 10;
    }
  }
}

// The values of an axis that its courses and the threshold need.
function courseRange({ courses, threshold, low: least = Infinity, high: most = Infinity }) {
  let [low, high] = threshold === null ? [Infinity, -Infinity] : [threshold, threshold];
  for (const { values } of courses) {
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) [low, high] = [0, 1];
  low = Math.min(low, least);
  high = Math.max(Math.min(high, most), low);
  const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
  return [low - room, high + room];
}

// The gap between the boxes of two entities at each instant in m, constant for a recording.
const gapsKnown = new WeakMap();

function gapsOf(recording, ego, other) {
  if (!gapsKnown.has(recording)) gapsKnown.set(recording, new Map());
  const known = gapsKnown.get(recording);
  const key = `${ego} ${other}`;
  if (!known.has(key)) {
    const gaps = Float64Array.from(recording.time, (time) => {
      const [one, another] = [boxAt(recording, ego, time), boxAt(recording, other, time)];
      return one && another ? boxGap(one, another) : NaN;
    });
    known.set(key, gaps);
  }
  return known.get(key);
}

// The gap of two boxes in m; 0 if they touch. Two convex shapes are nearest at a corner of one of them.
function boxGap(one, other) {
  const both = [[one, cornersOf(other)], [other, cornersOf(one)]];
  const isApart = both.some(([box, corners]) =>
    [[box.cos, box.sin, box.halfLength], [-box.sin, box.cos, box.halfWidth]].some(([cos, sin, half]) => {
      const along = corners.map(([x, y]) => (x - box.x) * cos + (y - box.y) * sin);
      return Math.min(...along) > half || Math.max(...along) < -half;
    }),
  );
  if (!isApart) return 0;
  const gaps = both.flatMap(([box, corners]) =>
    corners.map(([x, y]) => {
      const [u, v] = nearestOf(box, x, y);
      return Math.hypot(x - u, y - v);
    }),
  );
  return Math.min(...gaps);
}

function drawThresholdLine(context, y, left, right, colours) {
  context.strokeStyle = context.fillStyle = colours.hit;
  context.lineWidth = 1;
  context.setLineDash([2, 3]);
  context.beginPath();
  context.moveTo(left, y);
  context.lineTo(right, y);
  context.stroke();
  context.setLineDash([]);
  context.textAlign = "right";
  context.fillText("threshold", right - 2, y - 4);
}

function drawCourse(context, { slot, time, values }, across, down, colours) {
  context.strokeStyle = colours[slot];
  context.lineWidth = 1.8;
  context.setLineDash(slot === "beside" ? [5, 4] : []);
  context.beginPath();
  let drawn = false;
  for (let k = 0; k < values.length; k++) {
    if (Number.isNaN(values[k])) drawn = false;
    else if (drawn) context.lineTo(across(time[k]), down(values[k]));
    else context.moveTo(across(time[k]), down(values[k]));
    drawn = !Number.isNaN(values[k]);
  }
  context.stroke();
  context.setLineDash([]);
}
