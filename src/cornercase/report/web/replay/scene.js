"use strict";

// One scene: the road, and the entities of a recording on it at a time.

const SCENE_FONT = "12px system-ui, sans-serif";
const LONGEST_LABEL = 24;
// Minimum size of a pedestrian in pixels, to be visible from afar.
const SMALLEST_RADIUS = 4;
// Positions of all entities together.
const MOST_TRAILED = 20_000;
const SCALE_BARS = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];

const SCENE_COLOURS = [
  "ground", "road", "walk", "verge", "edge", "marking", "ego", "other", "third", "shadow", "hit", "label", "halo",
];

function sceneColours(element) {
  const style = getComputedStyle(element);
  return Object.fromEntries(SCENE_COLOURS.map((name) => [name, style.getPropertyValue(`--scene-${name}`).trim()]));
}

// Input of a scene: { width, height, view, recording, time, ego, other, others, road, colours, sight }, where
// `ego` and `other` are indices of entities, or -1, and `others` those of all that the ego is measured against.
function drawScene(context, scene) {
  const { width, height, view, recording, time, colours } = scene;
  const place = (x, y) => [width / 2 + (x - view.x) * view.scale, height / 2 - (y - view.y) * view.scale];
  const boxes = boxesAt(recording, time);
  context.fillStyle = colours.ground;
  context.fillRect(0, 0, width, height);
  if (scene.road) scene.road.draw(context, place, view.scale, colours);
  else drawGrid(context, place, view, width, height, colours.edge);
  const lookOf = (entity) => (entity === scene.ego ? "ego" : scene.others.includes(entity) ? "other" : "third");
  if (scene.sight) drawShadows(context, scene, boxes, place);
  recording.names.forEach((_, entity) => drawTrail(context, scene, entity, lookOf(entity), place));
  boxes.forEach((box, entity) => {
    if (box) drawEntity(context, box, recording.kinds[entity], colours[lookOf(entity)], colours, place, view.scale);
  });
  if (scene.sight) drawLook(context, scene, boxes, place);
  const past = recording.collisions.filter(([when]) => time >= when - 1e-6);
  const taken = past.map((collision) => drawCollision(context, scene, collision, place)).filter(Boolean);
  drawLabels(context, scene, boxes, lookOf, place, taken);
  drawScaleBar(context, view.scale, height, colours);
}

function polygon(context, points, place) {
  context.beginPath();
  points.forEach(([x, y], k) => {
    const at = place(x, y);
    if (k === 0) context.moveTo(...at);
    else context.lineTo(...at);
  });
  context.closePath();
}

// Areas hidden from the ego; the main other entity casts no shadow, as the reader looks for it.
function drawShadows(context, scene, boxes, place) {
  const own = boxes[scene.ego];
  if (!own) return;
  const eye = eyeOf(own);
  context.save();
  context.fillStyle = scene.colours.shadow;
  // All shadows at once, so that overlaps are not darker.
  context.beginPath();
  boxes.forEach((box, entity) => {
    if (!box || entity === scene.ego || entity === scene.other) return;
    const shadow = shadowOf(box, eye);
    shadow?.forEach(([x, y], k) => {
      if (k === 0) context.moveTo(...place(x, y));
      else context.lineTo(...place(x, y));
    });
    if (shadow) context.closePath();
  });
  context.fill("nonzero");
  context.restore();
}

// The line from the ego's eye to the other: solid if visible, dashed if hidden.
function drawLook(context, scene, boxes, place) {
  const seen = sees(boxes, scene.ego, scene.other);
  if (seen === null) return;
  const eye = place(...eyeOf(boxes[scene.ego]));
  const goal = place(boxes[scene.other].x, boxes[scene.other].y);
  context.save();
  context.strokeStyle = scene.colours.ego;
  context.lineWidth = seen ? 1.6 : 1.2;
  context.setLineDash(seen ? [] : [2, 5]);
  context.beginPath();
  context.moveTo(...eye);
  context.lineTo(...goal);
  context.stroke();
  context.setLineDash([]);
  context.fillStyle = scene.colours.halo;
  context.beginPath();
  context.arc(...eye, 3, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
  context.restore();
}

// Past positions of an entity as a line, future ones as dots; the other's line is dashed.
function drawTrail(context, scene, entity, look, place) {
  const { recording, time, colours } = scene;
  // In dense traffic, the paths of all would be slow to draw and hide the important ones.
  if (look === "third" && recording.names.length * recording.time.length > MOST_TRAILED) return;
  const [x, y] = waysOf(recording)[entity];
  const now = instantBefore(recording.time, time);
  const stroke = (first, last) => {
    context.beginPath();
    let down = false;
    for (let k = first; k <= last; k++) {
      const at = place(x[k], y[k]);
      if (!Number.isFinite(at[0])) down = false;
      else if (down) context.lineTo(...at);
      else context.moveTo(...at);
      down = Number.isFinite(at[0]);
    }
    context.stroke();
  };
  context.save();
  context.strokeStyle = colours[look];
  context.lineWidth = look === "third" ? 1 : 1.6;
  context.setLineDash(look === "other" ? [6, 4] : []);
  context.globalAlpha = 0.85;
  stroke(0, now);
  context.setLineDash([1.5, 5]);
  context.globalAlpha = 0.5;
  stroke(Math.max(now, 0), recording.time.length - 1);
  context.restore();
}

function drawEntity(context, box, kind, colour, colours, place, scale) {
  context.save();
  context.translate(...place(box.x, box.y));
  context.rotate(-box.heading);
  context.lineWidth = 1.2;
  context.strokeStyle = colours.halo;
  context.fillStyle = colour;
  const [long, wide] = [box.halfLength * scale, box.halfWidth * scale];
  if (kind === "pedestrian") {
    const radius = Math.max(long, wide, SMALLEST_RADIUS);
    context.beginPath();
    context.arc(0, 0, radius, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    context.beginPath();
    context.moveTo(radius + 5, 0);
    context.lineTo(radius, -3.5);
    context.lineTo(radius, 3.5);
    context.closePath();
    context.fill();
  } else {
    context.beginPath();
    context.rect(-long, -wide, 2 * long, 2 * wide);
    context.fill();
    context.stroke();
    // The nose: a light wedge whose tip is the middle of the front.
    context.fillStyle = colours.halo;
    context.globalAlpha = 0.85;
    context.beginPath();
    context.moveTo(long * 0.92, 0);
    context.lineTo(long * 0.45, -wide * 0.75);
    context.lineTo(long * 0.45, wide * 0.75);
    context.closePath();
    context.fill();
  }
  context.restore();
}

function shortName(name) {
  const letters = [...name];
  return letters.length > LONGEST_LABEL ? `${letters.slice(0, LONGEST_LABEL - 1).join("")}…` : name;
}

// The upper one of ego and other has its label above, so that labels do not overlap when they meet.
function labelsAbove(scene, boxes, place) {
  const up = (entity) => (boxes[entity] ? place(boxes[entity].x, boxes[entity].y)[1] : Infinity);
  const egoFirst = up(scene.ego) <= up(scene.other);
  return (entity) => entity !== (egoFirst ? scene.other : scene.ego);
}

// How far a box reaches up and down from its middle, in pixels.
function reachOf(box, view) {
  const reach = Math.abs(box.sin) * box.halfLength + Math.abs(box.cos) * box.halfWidth;
  return Math.max(reach * view.scale, SMALLEST_RADIUS);
}

// Labels stand beside boxes, those of ego and other first; other labels are left out if they would cover these, or what
// is taken already.
function drawLabels(context, scene, boxes, lookOf, place, taken) {
  const above = labelsAbove(scene, boxes, place);
  const order = boxes.map((_, entity) => entity).filter((entity) => boxes[entity]);
  order.sort((one, other) => (lookOf(one) === "third") - (lookOf(other) === "third"));
  for (const entity of order) {
    const [box, look, name] = [boxes[entity], lookOf(entity), shortName(unturned(scene.recording.names[entity]))];
    const { colours, view } = scene;
    const stands = !(Math.abs(box.speed) > 0.05);
    const text = look === "third" && stands ? name : `${name} ${box.speed.toFixed(1)} m/s`;
    const [across, y] = place(box.x, box.y);
    const reach = reachOf(box, view);
    context.font = SCENE_FONT;
    const half = context.measureText(text).width / 2 + 2;
    // At the edge of the scene the label is moved inside.
    const isThere = across > 0 && across < scene.width;
    const x = isThere ? Math.max(half, Math.min(across, scene.width - half)) : across;
    const heights = above(entity) ? [y - reach - 8, y + reach + 16] : [y + reach + 16, y - reach - 8];
    const clear = ([left, right, up], down) => x + half < left || x - half > right || Math.abs(up - down) > 14;
    const free = (down) => taken.every((one) => clear(one, down));
    const down = heights.find(free) ?? (look === "third" ? undefined : heights[0]);
    if (down === undefined) continue;
    taken.push([x - half, x + half, down]);
    writeText(context, text, x, down, colours[look], colours.halo, "center");
  }
}

function writeText(context, text, x, y, colour, halo, align = "left") {
  context.font = SCENE_FONT;
  context.textAlign = align;
  context.lineJoin = "round";
  context.strokeStyle = halo;
  context.lineWidth = 3.5;
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

// A star, the only mark with this shape, with the time of the collision. Returns the place of the text.
function drawCollision(context, { recording, colours, view, width }, [when, one, another], place) {
  const [first, second] = [boxAt(recording, one, when), boxAt(recording, another, when)];
  if (!first || !second) return null;
  const [x, y] = place(...contactOf(first, second));
  context.save();
  context.fillStyle = colours.hit;
  context.strokeStyle = colours.halo;
  context.lineWidth = 1.2;
  context.beginPath();
  for (let k = 0; k < 16; k++) {
    const [radius, angle] = [k % 2 ? 5 : 11, (k * Math.PI) / 8];
    context.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
  }
  context.closePath();
  context.fill();
  context.stroke();
  context.restore();
  const text = `collision at ${when.toFixed(2)} s`;
  context.font = SCENE_FONT;
  // Beyond the label of the upper box, or below that of the lower one, so that it covers neither cars nor labels.
  const middles = [first, second].map((box) => [place(box.x, box.y)[1], reachOf(box, view)]);
  const up = Math.min(...middles.map(([middle, reach]) => middle - reach)) - 26;
  const down = up > 12 ? up : Math.max(...middles.map(([middle, reach]) => middle + reach)) + 34;
  const half = context.measureText(text).width / 2 + 2;
  const across = Math.max(half, Math.min(x, width - half));
  writeText(context, text, across, down, colours.hit, colours.halo, "center");
  return [across - half, across + half, down];
}

function drawScaleBar(context, scale, height, colours) {
  const length = SCALE_BARS.findLast((one) => one * scale <= 110) ?? SCALE_BARS[0];
  const [left, down] = [12, height - 12];
  context.strokeStyle = colours.label;
  context.lineWidth = 1.5;
  context.setLineDash([]);
  context.beginPath();
  context.moveTo(left, down - 5);
  context.lineTo(left, down);
  context.lineTo(left + length * scale, down);
  context.lineTo(left + length * scale, down - 5);
  context.stroke();
  writeText(context, `${length} m`, left + 5, down - 6, colours.label, colours.halo);
}

// The region [left, bottom, right, top] of entities during a time span; null if there are none.
function regionOf(recording, entities, begin, end, margin) {
  let [left, bottom, right, top] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const entity of entities) {
    for (let k = 0; k < recording.time.length; k++) {
      if (recording.time[k] < begin || recording.time[k] > end) continue;
      const box = boxAt(recording, entity, recording.time[k]);
      if (!box) continue;
      left = Math.min(left, box.x);
      right = Math.max(right, box.x);
      bottom = Math.min(bottom, box.y);
      top = Math.max(top, box.y);
    }
  }
  if (left > right) return null;
  return [left - margin, bottom - margin, right + margin, top + margin];
}

// The region around an entity in which it and another one are during a time span; null if they never are there together.
// The margin is wider along the longer side.
function regionAround(recording, entity, another, begin, end, margin) {
  let [left, bottom, right, top] = [0, 0, 0, 0];
  let together = false;
  for (const time of recording.time) {
    if (time < begin || time > end) continue;
    const [one, other] = [boxAt(recording, entity, time), boxAt(recording, another, time)];
    if (!one || !other) continue;
    together = true;
    left = Math.min(left, other.x - one.x);
    right = Math.max(right, other.x - one.x);
    bottom = Math.min(bottom, other.y - one.y);
    top = Math.max(top, other.y - one.y);
  }
  if (!together) return null;
  const [across, up] = right - left > top - bottom ? [margin, margin / 2] : [margin / 2, margin];
  return [left - across, bottom - up, right + across, top + up];
}
