"use strict";

const THUMBNAIL = { width: 96, height: 22 };

// Unpacks the courses of a metric, once for all views; resolves when their values are numbers.
function unpackCourses(all) {
  all.coming ??= unpack(all.values).then((bytes) => {
    all.values = new Uint16Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 2);
  });
  return all.coming;
}

// A column with the course of the shown metric in each row; null if the page has none.
function courseColumn(store, redraw) {
  const { metric } = store.options;
  const all = store.contents.courses?.[metric];
  if (!all) return null;
  return {
    key: "course",
    title: `${metric} over time`,
    width: Math.max(THUMBNAIL.width / rootSize() + 1.2, 0.52 * (metric.length + 10) + 1.3),
    fill: (cell, row) => {
      if (typeof all.values === "string") unpackCourses(all).then(redraw);
      else fillThumbnail(cell, store, all, row);
    },
  };
}

function rootSize() {
  return parseFloat(getComputedStyle(document.documentElement).fontSize) || 15;
}

function fillThumbnail(cell, store, all, row) {
  const { points, begin, end, values, low, high } = all;
  const first = row * points;
  if (values[first] === NOTHING) return;
  const { width, height } = THUMBNAIL;
  const ratio = Math.min(3, window.devicePixelRatio || 1);
  const canvas = document.createElement("canvas");
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  const g = canvas.getContext("2d");
  g.scale(ratio, ratio);
  const up = (value) => 2 + (height - 4) * (high > low ? (high - value) / (high - low) : 0.5);
  const threshold = store.threshold();
  if (threshold !== null && threshold >= low && threshold <= high) {
    g.strokeStyle = themeColours().danger;
    g.setLineDash([3, 2]);
    line(g, 0, up(threshold), width, up(threshold));
    g.setLineDash([]);
  }
  const latest = latestEnd(all);
  const { lower_is_critical: lower, name, unit } = store.metricOf();
  let worst = 0;
  g.beginPath();
  for (let k = 0; k < points; k++) {
    const number = values[first + k];
    if (lower ? number < values[first + worst] : number > values[first + worst]) worst = k;
    const time = begin[row] + ((end[row] - begin[row]) * k) / (points - 1);
    g.lineTo(1 + ((width - 2) * time) / latest, up(low + (number / (NOTHING - 1)) * (high - low)));
  }
  g.strokeStyle = themeColours().text;
  g.lineWidth = 1.3;
  g.stroke();
  const value = low + (values[first + worst] / (NOTHING - 1)) * (high - low);
  const time = begin[row] + ((end[row] - begin[row]) * worst) / (points - 1);
  const told = `${name} ${lower ? "lowest" : "highest"} at ${time.toFixed(1)} s: ${withUnit(Number(value.toPrecision(3)), unit)}`;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", told);
  canvas.title = told;
  cell.append(canvas);
}

// The latest end of all courses, so that a second is as wide in each row.
function latestEnd(all) {
  if (all.latest?.of !== all.end) all.latest = { of: all.end, time: all.end.reduce((one, other) => Math.max(one, other), 1e-9) };
  return all.latest.time;
}
