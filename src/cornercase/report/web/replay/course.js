"use strict";

// The course of the metric in the scenarios of the replay, with the threshold and a cursor at the clock's time.

const COURSE_EDGES = { left: 46, right: 10, top: 8, bottom: 32 };

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
    this.setCourses([], 0, 1, "", null);
    let dragging = false;
    const seekTo = (event) => {
      const { width } = this.size();
      const share = (event.offsetX - COURSE_EDGES.left) / (width - COURSE_EDGES.left - COURSE_EDGES.right);
      seek(this.begin + Math.min(Math.max(share, 0), 1) * (this.end - this.begin));
    };
    canvas.addEventListener("pointerdown", (event) => {
      dragging = true;
      canvas.setPointerCapture(event.pointerId);
      seekTo(event);
    });
    canvas.addEventListener("pointermove", (event) => dragging && seekTo(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (dragging = false));
  }

  size() {
    return { width: this.canvas.clientWidth, height: this.canvas.clientHeight };
  }

  // Courses are { slot, time, values }; the threshold may be null.
  setCourses(courses, begin, end, title, threshold) {
    Object.assign(this, { courses, begin, end: Math.max(end, begin + 1e-3), title, threshold });
    let [low, high] = threshold === null ? [Infinity, -Infinity] : [threshold, threshold];
    for (const { values } of courses) {
      for (const value of values) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high) [low, high] = [0, 1];
    const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
    this.range = [low - room, high + room];
  }

  draw(time, colours) {
    const { width, height } = this.size();
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    const { left, right, top, bottom } = COURSE_EDGES;
    const across = (t) => left + ((t - this.begin) / (this.end - this.begin)) * (width - left - right);
    const [low, high] = this.range;
    const down = (v) => height - bottom - ((v - low) / (high - low)) * (height - top - bottom);
    context.font = "11px system-ui, sans-serif";
    this.drawAxes(context, across, down, width, height, colours);
    context.save();
    context.beginPath();
    context.rect(left, 0, width - left - right, height);
    context.clip();
    if (this.threshold !== null) this.drawThreshold(context, down(this.threshold), width, colours);
    for (const course of this.courses) drawCourse(context, course, across, down, colours);
    context.restore();
    context.strokeStyle = colours.label;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(across(time), top);
    context.lineTo(across(time), height - bottom);
    context.stroke();
    for (const course of this.courses) {
      const value = between(course.values, momentOf(course.time, time));
      if (!Number.isFinite(value)) continue;
      context.fillStyle = colours[course.slot];
      context.beginPath();
      context.arc(across(Math.min(time, course.time[course.time.length - 1])), down(value), 4, 0, 2 * Math.PI);
      context.fill();
    }
  }

  drawAxes(context, across, down, width, height, colours) {
    const { left, right, top, bottom } = COURSE_EDGES;
    context.strokeStyle = colours.edge;
    context.fillStyle = colours.label;
    context.lineWidth = 1;
    context.beginPath();
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const tick of roundTicks(...this.range, Math.max(2, Math.floor(height / 40)))) {
      context.moveTo(left, down(tick));
      context.lineTo(width - right, down(tick));
      context.fillText(tickText(tick), left - 5, down(tick));
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const tick of roundTicks(this.begin, this.end, Math.max(2, Math.floor(width / 60)))) {
      context.moveTo(across(tick), height - bottom);
      context.lineTo(across(tick), height - bottom + 4);
      context.fillText(tickText(tick), across(tick), height - bottom + 5);
    }
    context.globalAlpha = 0.4;
    context.stroke();
    context.globalAlpha = 1;
    context.fillText("time [s]", (left + width - right) / 2, height - 13);
    context.save();
    context.translate(9, (top + height - bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.textBaseline = "middle";
    context.fillText(this.title, 0, 0);
    context.restore();
    context.textBaseline = "alphabetic";
  }

  drawThreshold(context, y, width, colours) {
    context.strokeStyle = context.fillStyle = colours.hit;
    context.lineWidth = 1;
    context.setLineDash([2, 3]);
    context.beginPath();
    context.moveTo(COURSE_EDGES.left, y);
    context.lineTo(width - COURSE_EDGES.right, y);
    context.stroke();
    context.setLineDash([]);
    context.textAlign = "right";
    context.fillText("threshold", width - COURSE_EDGES.right - 2, y - 4);
  }
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
