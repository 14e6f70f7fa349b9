"use strict";

// What is predicted between the scenarios of a plane, or where little is known: shading and contours below the points.

const SURFACES = ["off", "predicted", "unknown"];
// Nodes of a grid across and upwards; deviations cost more.
const NODES = { predicted: [56, 36], unknown: [36, 24] };
// Between these probabilities, it is open whether a scenario is critical.
const OPEN = [0.25, 0.75];
const STRONGEST = 0.42;

class Surface {
  constructor(plot) {
    this.plot = plot;
    this.store = plot.store;
  }

  get mode() {
    return this.store.options.surface;
  }

  // Indices of the parameters of both axes; null if one is no parameter, or both are the same.
  get axes() {
    const { parameters } = this.store.contents;
    const [x, y] = this.plot.columns().map((column) => {
      const [kind, key] = Store.split(column);
      return kind === "parameter" ? parameters.findIndex((one) => one.name === key) : -1;
    });
    return x < 0 || y < 0 || x === y ? null : [x, y];
  }

  // The scenario whose other parameters are kept: the selected one, or the most critical one.
  get scenario() {
    const { store } = this;
    return store.selected ?? store.contents.most_critical?.[store.options.metric] ?? store.contents.scenarios.id[0];
  }

  get threshold() {
    return this.store.contents.critical?.threshold ?? null;
  }

  get isLowerCritical() {
    return this.store.contents.critical?.lower_is_critical ?? this.store.contents.predictor.scale > 0;
  }

  get isDrawn() {
    return this.mode !== "off" && predictorOf(this.store) !== null && this.axes !== null;
  }

  // Values of the parameters that are not shown; they decide, with the axes, what is predicted.
  values() {
    const row = this.store.rows.get(this.scenario);
    return this.store.contents.scenarios.values.map((column) => column[row]);
  }

  draw(g) {
    this.drawn = null;
    if (!this.isDrawn) return;
    const { plot, store } = this;
    const [x, y] = this.axes;
    const others = this.values().filter((_, k) => k !== x && k !== y);
    const sides = [plot.x, plot.y].flatMap(({ low, high, from, to }) => [low, high, from, to]);
    const key = [this.mode, x, y, ...others, ...sides, isDark(), store.version, this.threshold].join(" ");
    if (this.key !== key) {
      this.key = key;
      this.made = this.make(x, y);
    }
    this.drawn = this.made;
    const { canvas, left, top } = this.made;
    g.drawImage(canvas, left, top);
    this.drawLines(g);
  }

  make(x, y) {
    const { plot, mode } = this;
    const predictor = predictorOf(this.store);
    const { parameters } = this.store.contents;
    const [across, up] = [[x, plot.x], [y, plot.y]].map(([k, scale], axis) =>
      gridAxis(parameters[k], scale, NODES[mode][axis]));
    const place = [this.values(), x, across.values, y, up.values];
    const scores = spread(predictor.scores(...place), across, up);
    const grid = { across, up, nx: across.places.length, ny: up.places.length };
    const { threshold } = this;
    const boundary = threshold === null ? null : { level: threshold, segments: contour(grid, scores, threshold) };
    if (mode === "predicted") {
      const [low, high] = this.scoreRange(scores);
      const levels = roundLevels(low, high, 8).filter((level) => !isNear(level, threshold, (high - low) / 30));
      const shades = [...levels, ...(threshold === null ? [] : [threshold])].sort((one, other) => one - other);
      const colours = bandMiddles(shades, low, high).map((value) => {
        const share = Math.max(0, Math.min(1, (value - low) / (high - low)));
        return packed(themeColours().danger, STRONGEST * (this.isLowerCritical ? 1 - share : share) ** 1.5);
      });
      const canvas = this.paint(grid, scores, shades, colours);
      return { canvas, ...this.corner(across, up), lines: this.linesOf(grid, scores, levels), boundary, low, high };
    }
    const deviations = spread(predictor.deviations(...place), across, up);
    const { most } = predictor;
    const levels = roundLevels(0, most, 6).filter((level) => level > 0);
    const colours = bandMiddles(levels, 0, most).map((value) => packed(themeColours().text, (STRONGEST * value) / most));
    const open = threshold === null ? null : scores.map((score, k) =>
      normalBelow((threshold - score) / Math.hypot(deviations[k], predictor.noise)));
    const canvas = this.paint(grid, deviations, levels, colours, open);
    const lines = this.linesOf(grid, deviations, levels);
    return { canvas, ...this.corner(across, up), lines, boundary, low: 0, high: most, open };
  }

  // Scores of the scenarios, so that a colour means the same in each plane.
  scoreRange(scores) {
    const { store } = this;
    const { metric } = store.contents.predictor;
    if (store.has(`score ${metric}`)) return finiteRange(store.column(`score ${metric}`));
    return finiteRange(scores);
  }

  linesOf(grid, values, levels) {
    return levels.map((level) => ({ level, segments: contour(grid, values, level) }));
  }

  corner(across, up) {
    return { left: across.places[0], top: up.places.at(-1) };
  }

  // A picture of the grid: the colour of each band between levels; `striped` is a grid with values where stripes are.
  paint(grid, values, levels, colours, striped = null) {
    const { across, up, nx } = grid;
    const canvas = document.createElement("canvas");
    const width = (canvas.width = Math.max(1, Math.round(across.places.at(-1) - across.places[0])));
    const height = (canvas.height = Math.max(1, Math.round(up.places[0] - up.places.at(-1))));
    const image = new ImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    const stripe = packed(themeColours().danger, 0.75);
    const [cells, shares] = cellsOf(across.places, across.places[0], width);
    const [rows, parts] = cellsOf(up.places, up.places.at(-1), height);
    for (let j = 0; j < height; j++) {
      const part = parts[j];
      for (let i = 0; i < width; i++) {
        const k = rows[j] * nx + cells[i];
        const share = shares[i];
        const value = valueWithin(values, k, nx, share, part);
        let band = 0;
        while (band < levels.length && value >= levels[band]) band++;
        pixels[j * width + i] = colours[band];
        if (striped === null || (i + j) % 7 > 1) continue;
        const open = valueWithin(striped, k, nx, share, part);
        if (open >= OPEN[0] && open <= OPEN[1]) pixels[j * width + i] = stripe;
      }
    }
    canvas.getContext("2d").putImageData(image, 0, 0);
    return canvas;
  }

  drawLines(g) {
    const colours = themeColours();
    const { lines, boundary } = this.drawn;
    g.save();
    g.lineCap = "round";
    g.strokeStyle = colours.faint;
    g.lineWidth = 0.8;
    g.globalAlpha = 0.75;
    for (const { segments } of lines) strokeSegments(g, segments);
    g.globalAlpha = 1;
    for (const [width, colour] of boundary === null ? [] : [[5.5, colours.raised], [2.8, colours.text]]) {
      g.lineWidth = width;
      g.strokeStyle = colour;
      strokeSegments(g, boundary.segments);
    }
    g.restore();
  }

  // Above the points, which would hide the labels.
  drawLabels(g) {
    if (!this.drawn) return;
    const colours = themeColours();
    const { unit } = this.store.contents.predictor;
    const { lines, boundary } = this.drawn;
    const plusMinus = this.mode === "unknown" ? "± " : "";
    const texts = boundary === null ? [] : [[boundary, `critical ${withUnit(boundary.level, unit)}`]];
    for (const one of lines) texts.push([one, plusMinus + withUnit(one.level, unit)]);
    const placed = [];
    g.save();
    g.font = `11px ${colours.font}`;
    g.textAlign = "center";
    g.textBaseline = "middle";
    for (const [{ segments }, text] of texts) {
      const half = g.measureText(text).width / 2 + 3;
      const place = this.labelPlace(segments, placed, half);
      if (place === null) continue;
      placed.push([...place, half]);
      g.fillStyle = colours.raised;
      g.globalAlpha = 0.88;
      g.beginPath();
      g.roundRect(place[0] - half, place[1] - 7.5, 2 * half, 15, 4);
      g.fill();
      g.globalAlpha = 1;
      g.fillStyle = colours.text;
      g.fillText(text, ...place);
    }
    g.restore();
  }

  // The middle of the segment that is farthest from borders and other labels; null if all are too near.
  labelPlace(segments, placed, half) {
    const { plot } = this;
    let best = null;
    let most = 14;
    const step = Math.max(1, Math.floor(segments.length / 160));
    for (let k = 0; k < segments.length; k += 4 * step) {
      const [x, y] = [(segments[k] + segments[k + 2]) / 2, (segments[k + 1] + segments[k + 3]) / 2];
      const border = Math.min(
        x - half - plot.left, plot.width - plot.right - x - half, y - plot.top, plot.height - plot.bottom - y);
      let room = Math.min(border + 8, 90);
      for (const [px, py, wide] of placed) {
        room = Math.min(room, Math.max(Math.abs(px - x) - wide - half + 14, Math.abs(py - y)));
      }
      if (room > most) [most, best] = [room, [x, y]];
    }
    return best;
  }

  // Why nothing is drawn, or what it is and how good.
  tell() {
    const { store } = this;
    const { predictor, predictor_missing: missing, parameters } = store.contents;
    if (this.mode === "off") return "";
    if (!predictor) return missing || "Nothing can be predicted yet.";
    if (this.axes === null) return "For a prediction, choose two different parameters as axes.";
    const [x, y] = this.axes;
    const row = store.rows.get(this.scenario);
    const others = parameters.map((_, k) => k).filter((k) => k !== x && k !== y && isVaried(parameters[k]));
    const named = others.map((k) => `${parameters[k].name} ${shortened(parameterText(store, k, row), 24)}`);
    const as = `as in scenario ${this.scenario}`;
    const kept = others.length > 3 ? `the other ${others.length} parameters ${as}` : `${named.join(", ")}, ${as}`;
    const share = Math.round(100 * predictor.predicted);
    const known = knownOf(store);
    const constrained = this.axes.some((k) => predictor.constrained.includes(k));
    return unturned([
      `Predicts ${share} % of the variance of ${predictor.metric}, with each scenario left out in turn.`,
      known === null ? "" : `Of the first ${known} scenarios.`,
      others.length ? `Here with ${kept}.` : "",
      constrained ? "Constraints of the scenario rule out some of the area." : "",
    ].filter(Boolean).join(" "));
  }

  fillLegend(list) {
    list.replaceChildren();
    if (!this.drawn) return;
    const { metric, unit } = this.store.contents.predictor;
    const { low, high, boundary, open } = this.drawn;
    const isPredicted = this.mode === "predicted";
    const [red, green, blue] = rgbOf(themeColours()[isPredicted ? "danger" : "text"]);
    const ends = isPredicted && this.isLowerCritical ? [STRONGEST, 0] : [0, STRONGEST];
    const title = isPredicted ? `predicted ${metric}` : `uncertainty of ${metric}: ±`;
    const item = legendItem(list, `${title} ${formatNumber(Number(low.toPrecision(3)))}`);
    const bar = document.createElement("span");
    bar.className = "bar";
    bar.style.background = `linear-gradient(to right, ${ends.map((a) => `rgb(${red} ${green} ${blue} / ${a})`).join(", ")})`;
    item.append(bar, withUnit(Number(high.toPrecision(3)), unit));
    if (boundary !== null) {
      legendItem(list, boundary.segments.length ? "predicted critical boundary" : "the boundary is outside", (g) => {
        g.lineWidth = 2.8;
        g.strokeStyle = themeColours().text;
        line(g, 0, 8, 16, 8);
      });
    }
    if (open) {
      legendItem(list, `critical or not: ${100 * OPEN[0]} to ${100 * OPEN[1]} %`, (g) => {
        g.lineWidth = 1.6;
        g.strokeStyle = themeColours().danger;
        for (const k of [-8, -1, 6]) line(g, k, 15, k + 14, 1);
      });
    }
  }
}

function isVaried({ choices, low, high }) {
  return choices.length ? choices.length > 1 : high > low;
}

// Places of an axis in pixels, and the values there: each choice is a strip.
function gridAxis({ choices, low, high }, scale, count) {
  if (choices.length || !(high > low)) {
    const values = choices.length ? choices.map((_, k) => k) : [low];
    const ends = choices.length ? (k) => [k - 0.5, k + 0.5] : () => [scale.low, scale.high];
    return {
      values,
      places: values.flatMap((k) => ends(k).map((value) => scale.at(value))),
      index: values.flatMap((_, k) => [k, k]),
    };
  }
  const values = Array.from({ length: count }, (_, k) => low + ((high - low) * k) / (count - 1));
  return { values, places: values.map((value) => scale.at(value)), index: values.map((_, k) => k) };
}

// Values at the nodes of a grid, from those of its different values.
function spread(values, across, up) {
  const [nx, width] = [across.index.length, across.values.length];
  const found = new Float64Array(nx * up.index.length);
  up.index.forEach((b, j) => across.index.forEach((a, i) => (found[j * nx + i] = values[b * width + a])));
  return found;
}

// For each of some pixels from `first` on the cell in which it is, and its share of the way to the next node.
function cellsOf(places, first, count) {
  const sign = places.at(-1) > places[0] ? 1 : -1;
  const cells = new Uint16Array(count);
  const shares = new Float64Array(count);
  for (let i = 0; i < count; i++) {
    const pixel = first + i + 0.5;
    let [low, high] = [0, places.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (sign * (pixel - places[middle]) >= 0) low = middle;
      else high = middle;
    }
    const wide = places[low + 1] - places[low];
    cells[i] = low;
    shares[i] = wide ? Math.max(0, Math.min(1, (pixel - places[low]) / wide)) : 0;
  }
  return [cells, shares];
}

// The value within the cell of node k, by its shares of the way across and upwards.
function valueWithin(values, k, nx, share, part) {
  const low = values[k] + share * (values[k + 1] - values[k]);
  const high = values[k + nx] + share * (values[k + nx + 1] - values[k + nx]);
  return low + part * (high - low);
}

// Segments of a contour, as x0, y0, x1, y1, … in pixels, by marching squares.
function contour({ across, up, nx, ny }, values, level) {
  const found = [];
  const [xs, ys] = [across.places, up.places];
  const cross = (k, n, from, to) => from + ((level - values[k]) / (values[n] - values[k])) * (to - from);
  for (let b = 0; b < ny - 1; b++) {
    for (let a = 0; a < nx - 1; a++) {
      const [k, right, above, far] = [b * nx + a, b * nx + a + 1, (b + 1) * nx + a, (b + 1) * nx + a + 1];
      const [p, q, r, s] = [values[k] < level, values[right] < level, values[far] < level, values[above] < level];
      if (p === q && q === r && r === s) continue;
      const places = [];
      if (p !== q) places.push(cross(k, right, xs[a], xs[a + 1]), ys[b]);
      if (q !== r) places.push(xs[a + 1], cross(right, far, ys[b], ys[b + 1]));
      if (r !== s) places.push(cross(above, far, xs[a], xs[a + 1]), ys[b + 1]);
      if (s !== p) places.push(xs[a], cross(k, above, ys[b], ys[b + 1]));
      // Of a saddle, the middle decides which corners belong together.
      const isSplit = places.length === 8 &&
        p !== (values[k] + values[right] + values[above] + values[far] < 4 * level);
      if (isSplit) places.push(...places.splice(0, 2));
      found.push(...places);
    }
  }
  return found;
}

function strokeSegments(g, segments) {
  g.beginPath();
  for (let k = 0; k < segments.length; k += 4) {
    g.moveTo(segments[k], segments[k + 1]);
    g.lineTo(segments[k + 2], segments[k + 3]);
  }
  g.stroke();
}

// At most so many round numbers between two numbers.
function roundLevels(low, high, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].find((one) => one * power >= rough) ?? 10);
  const levels = [];
  for (let k = Math.ceil(low / step); k * step <= high && levels.length <= most; k++) {
    levels.push(Number((k * step).toPrecision(12)));
  }
  return levels;
}

function isNear(level, other, distance) {
  return other !== null && Math.abs(level - other) < distance;
}

// The middles of the bands between levels; the first and the last band are as their ends.
function bandMiddles(levels, low, high) {
  if (!levels.length) return [(low + high) / 2];
  return [low, ...levels.slice(1).map((level, k) => (levels[k] + level) / 2), high];
}

// A colour as the pixels of a picture hold it, which begin with red.
function packed(colour, alpha) {
  const [red, green, blue] = rgbOf(colour);
  return ((Math.round(255 * alpha) << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

function rgbOf(colour) {
  return [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
}
