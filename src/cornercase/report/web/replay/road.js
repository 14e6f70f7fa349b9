"use strict";

// The road below a scene, from the encoded road outline: areas of lanes, whose union has the edges of the road as its
// outline, and lines between lanes.

// From bottom to top: driving lanes win where areas overlap.
const AREA_KINDS = ["verge", "walk", "road"];

class RoadDrawing {
  constructor(roads) {
    this.origin = roads.origin;
    this.areas = RoadDrawing.paths(roads.areas, true);
    this.lines = RoadDrawing.paths(roads.lines, false);
  }

  // Paths by kind, in m from the origin: far from it, path coordinates would be inexact.
  static paths(shapes, closed) {
    const found = new Map();
    for (const [kind, numbers] of shapes) {
      if (!found.has(kind)) found.set(kind, []);
      const path = new Path2D();
      let [x, y] = [0, 0];
      for (let k = 0; k < numbers.length; k += 2) {
        x += numbers[k] / 100;
        y += numbers[k + 1] / 100;
        if (k === 0) path.moveTo(x, y);
        else path.lineTo(x, y);
      }
      if (closed) path.closePath();
      found.get(kind).push(path);
    }
    return found;
  }

  // `place(x, y)` gives the pixels of a point of the plane, `scale` pixels per metre.
  draw(context, place, scale, colours) {
    context.save();
    context.translate(...place(...this.origin));
    context.scale(scale, -scale);
    context.lineJoin = "round";
    for (const kind of AREA_KINDS) {
      const paths = this.areas.get(kind) ?? [];
      // All outlines first: the filled areas cover the inner ones, and only the outline of the union is left.
      context.strokeStyle = colours.edge;
      context.lineWidth = 2.4 / scale;
      for (const path of paths) context.stroke(path);
      context.fillStyle = context.strokeStyle = colours[kind];
      context.lineWidth = 0.6 / scale;
      for (const path of paths) {
        context.fill(path);
        context.stroke(path);
      }
    }
    context.strokeStyle = colours.marking;
    context.lineWidth = Math.max(0.12, 1 / scale);
    for (const [kind, paths] of this.lines) {
      context.setLineDash(kind === "lane" ? [3, 3] : []);
      for (const path of paths) context.stroke(path);
    }
    context.restore();
  }
}

// Without a road, lines every 10 m show the motion.
function drawGrid(context, place, view, width, height, colour) {
  const step = 10 * 10 ** Math.max(0, Math.ceil(Math.log10(12 / (10 * view.scale))));
  context.save();
  context.strokeStyle = colour;
  context.globalAlpha = 0.35;
  context.lineWidth = 1;
  context.beginPath();
  const [halfWide, halfHigh] = [width / 2 / view.scale, height / 2 / view.scale];
  for (let x = Math.ceil((view.x - halfWide) / step) * step; x <= view.x + halfWide; x += step) {
    const [right] = place(x, 0);
    context.moveTo(right, 0);
    context.lineTo(right, height);
  }
  for (let y = Math.ceil((view.y - halfHigh) / step) * step; y <= view.y + halfHigh; y += step) {
    const [, down] = place(0, y);
    context.moveTo(0, down);
    context.lineTo(width, down);
  }
  context.stroke();
  context.restore();
}
