"use strict";

// Kernel space of an aspect: similar scenarios are close. Three components form a cube that can be turned.
const TURN = Math.PI / 12;

class KernelPlot extends PointPlot {
  constructor(box, store) {
    super(box, store, { name: "kernel" });
    this.yaw = -0.6;
    this.pitch = 0.42;
    this.pending = null;
    this.last = null;
  }

  title() {
    return `Kernel space by ${this.store.options.aspect}`;
  }

  components() {
    const { store } = this;
    const key = `${store.version} ${store.options.aspect}`;
    if (this.known !== key) {
      this.known = key;
      const { embedding } = store.contents.kinds[store.options.aspect];
      this.columns = embedding.map((column) => Float64Array.from(column, (value) => value ?? NaN));
      this.spans = this.columns.map(finiteRange);
    }
    return this.columns;
  }

  get solid() {
    return this.components().length > 2;
  }

  drawBase(g) {
    const columns = this.components();
    if (this.solid) this.drawCube(g);
    else this.drawPlane(g, columns);
  }

  drawPlane(g, columns) {
    const { store } = this;
    const scores = `score ${store.options.metric}`;
    const second = columns[1] ?? store.column(scores);
    this.scaleX(...this.spans[0], []);
    this.scaleY(...finiteRange(second), []);
    this.drawAxes(g, "component 1 [1]", columns[1] ? "component 2 [1]" : store.axis(scores).title);
    const there = columns[0].map((value, row) => value + 0 * second[row]);
    this.drawPoints(g, there.map((value) => this.x.at(value)), second.map((value) => this.y.at(value)));
  }

  // Projection of a point of the cube (-1 to 1), and its depth behind the centre.
  seen(a, b, c) {
    const [sin, cos] = [Math.sin(this.yaw), Math.cos(this.yaw)];
    const [up, flat] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const right = a * cos - b * sin;
    const back = a * sin + b * cos;
    const height = c * flat + back * up;
    const depth = back * flat - c * up;
    const size = (Math.min(this.width, this.height * 1.2) / 4.6) * (5 / (5 + depth));
    return [this.width / 2 + right * size, this.height / 2 - height * size, depth];
  }

  drawCube(g) {
    const { store, columns, spans } = this;
    this.drawFrame(g);
    const place = ([low, high], value) => (high > low ? (2 * (value - low)) / (high - low) - 1 : 0);
    const [px, py, depth] = [0, 1, 2].map(() => new Float64Array(store.n));
    for (let row = 0; row < store.n; row++) {
      const point = spans.map((span, k) => place(span, columns[k][row]));
      [px[row], py[row], depth[row]] = this.seen(...point);
    }
    const order = Uint32Array.from(depth, (_, row) => row);
    order.sort((one, other) => depth[other] - depth[one] || one - other);
    this.drawPoints(g, px, py, order);
  }

  drawFrame(g) {
    const colours = themeColours();
    const corners = [];
    for (const a of [-1, 1]) for (const b of [-1, 1]) for (const c of [-1, 1]) corners.push([a, b, c]);
    g.strokeStyle = colours.line;
    g.lineWidth = 1;
    for (const one of corners) {
      for (const other of corners) {
        const differ = [0, 1, 2].filter((k) => one[k] < other[k]);
        const same = [0, 1, 2].filter((k) => one[k] === other[k]);
        if (differ.length !== 1 || same.length !== 2) continue;
        const [from, to] = [this.seen(...one), this.seen(...other)];
        line(g, from[0], from[1], to[0], to[1]);
      }
    }
    this.drawNames(g);
  }

  // Each component is labelled at the lowest outer edge, with its minimum and maximum at the ends.
  drawNames(g) {
    const colours = themeColours();
    g.textBaseline = "middle";
    [0, 1, 2].forEach((k) => {
      const edges = [[-1, -1], [-1, 1], [1, -1], [1, 1]].map(([one, other]) => {
        const point = (value) => [0, 1, 2].map((axis) => (axis === k ? value : axis === (k + 1) % 3 ? one : other));
        return { from: this.seen(...point(-1)), to: this.seen(...point(1)) };
      });
      const outer = ({ from, to }) => (k === 2 ? -(from[0] + to[0]) : from[1] + to[1]);
      const { from, to } = edges.reduce((one, other) => (outer(other) > outer(one) ? other : one));
      const middle = [this.width / 2, this.height / 2];
      const shift = k === 2 ? [-1, 0] : [Math.sign((from[0] + to[0]) / 2 - middle[0]) * 0.5, 1];
      const put = (text, share, far) => {
        const x = from[0] + share * (to[0] - from[0]) + shift[0] * far;
        const y = from[1] + share * (to[1] - from[1]) + shift[1] * far;
        // On a narrow page labels move closer to the cube to stay complete.
        const wide = g.measureText(text).width + 2;
        const right = k !== 2 && shift[0] > 0;
        g.textAlign = right ? "left" : "right";
        g.fillText(text, right ? Math.min(x, this.width - wide) : Math.max(x, wide), y);
      };
      g.font = `11px ${colours.font}`;
      g.fillStyle = colours.faint;
      this.spans[k].forEach((value, end) => put(formatNumber(Number(value.toPrecision(2))), 0.06 + 0.88 * end, 9));
      g.font = `12px ${colours.font}`;
      g.fillStyle = colours.text;
      put(`component ${k + 1} [1]`, 0.5, k === 2 ? 6 : 14);
    });
  }

  drawOver(g) {
    this.drawMarks(g);
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.4, Math.min(1.4, this.pitch + pitch));
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      this.redraw(new Set(["options"]));
    });
  }

  // Dragging turns the cube.
  brushTo(start, now) {
    if (!this.solid) return;
    const from = this.last?.start === start ? this.last.now : start;
    this.last = { start, now };
    this.turn((from[0] - now[0]) * -0.01, (now[1] - from[1]) * 0.01);
  }

  key(event) {
    const turns = { ArrowLeft: [TURN, 0], ArrowRight: [-TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] };
    if (event.shiftKey && event.key in turns) {
      event.preventDefault();
      this.turn(...turns[event.key]);
    } else {
      super.key(event);
    }
  }
}

VIEWS.push({
  name: "kernel",
  title: "Kernel space",
  about: (store) => `Near each other: alike by ${store.options.aspect}.`,
  more: (store) => {
    const { aspect } = store.options;
    const { embedding, compares } = store.contents.kinds[aspect];
    const what = compares ? ` (${compares})` : "";
    const turn = embedding.length > 2 ? " Drag to turn the space." : "";
    return `Scenarios that are near each other here are alike by ${aspect}${what}.${turn}`;
  },
  known: true,
  wanted: (store) => store.options.aspect !== null && store.contents.kinds[store.options.aspect].embedding.length > 0,
  create(box, store) {
    const plot = new KernelPlot(box, store);
    const turns = document.createElement("div");
    turns.className = "options turns";
    for (const [text, name, yaw, pitch] of [
      ["←", "Turn left", TURN, 0],
      ["→", "Turn right", -TURN, 0],
      ["↑", "Turn up", 0, TURN],
      ["↓", "Turn down", 0, -TURN],
    ]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.title = name;
      button.setAttribute("aria-label", name);
      button.addEventListener("click", () => plot.turn(yaw, pitch));
      turns.append(button);
    }
    const legend = document.createElement("ul");
    legend.className = "legend";
    box.append(turns, legend);
    return {
      plot,
      redraw(events) {
        if (store.options.aspect === null) return;
        plot.redraw(events);
        if (onlyMarks(events)) return;
        turns.hidden = !plot.solid;
        fillLegend(legend, store);
      },
    };
  },
});
