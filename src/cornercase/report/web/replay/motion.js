"use strict";

// Positions of the entities of a recording at a time, and its courses.

// The last instant that is not after a time; -1 before the first one.
function instantBefore(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    // The page stores times to a tenth of a millisecond.
    if (times[middle] <= time + 1e-6) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

function instantNearest(times, time) {
  const k = Math.max(0, instantBefore(times, time));
  return k + 1 < times.length && times[k + 1] - time < time - times[k] ? k + 1 : k;
}

// A time between two instants: the earlier one, the later one, and the fraction between them.
function momentOf(times, time) {
  const k = Math.min(Math.max(0, instantBefore(times, time)), times.length - 1);
  if (k + 1 >= times.length || time <= times[k]) return [k, k, 0];
  const share = (time - times[k]) / (times[k + 1] - times[k]);
  return share < 1e-4 ? [k, k, 0] : [k, k + 1, Math.min(share, 1)];
}

function between(values, [first, second, share]) {
  if (share === 0) return values[first];
  const one = values[first];
  const other = values[second];
  // An entity that appears or disappears between two instants stays at the one where it exists.
  if (Number.isNaN(one)) return share > 0.5 ? other : NaN;
  if (Number.isNaN(other)) return share <= 0.5 ? one : NaN;
  return one + share * (other - one);
}

function headingBetween(values, [first, second, share]) {
  const one = values[first];
  const other = values[second];
  if (share === 0 || Number.isNaN(one) || Number.isNaN(other)) return between(values, [first, second, share]);
  const turn = other - one;
  return one + share * (turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI)));
}

// The box of an entity at a time, or null if it does not exist.
function boxAt(recording, entity, time) {
  const moment = momentOf(recording.time, time);
  const heading = headingBetween(recording.heading[entity], moment);
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const ahead = recording.center_x[entity];
  const x = between(recording.x[entity], moment) + ahead * cos;
  const y = between(recording.y[entity], moment) + ahead * sin;
  if (!Number.isFinite(x + y)) return null;
  return {
    x, y, heading, cos, sin,
    halfLength: recording.length[entity] / 2,
    halfWidth: recording.width[entity] / 2,
    speed: between(recording.speed[entity], moment),
    acceleration: between(recording.acceleration[entity], moment),
  };
}

// Paths of the box centres, constant for a recording: x and y for each entity.
const waysKnown = new WeakMap();

function waysOf(recording) {
  if (!waysKnown.has(recording)) {
    const ways = recording.names.map((_, entity) => {
      const ahead = recording.center_x[entity];
      const heading = recording.heading[entity];
      return [
        recording.x[entity].map((x, k) => x + ahead * Math.cos(heading[k])),
        recording.y[entity].map((y, k) => y + ahead * Math.sin(heading[k])),
      ];
    });
    waysKnown.set(recording, ways);
  }
  return waysKnown.get(recording);
}

function boxesAt(recording, time) {
  return recording.names.map((_, entity) => boxAt(recording, entity, time));
}

// A point of a box by its coordinates along and across, each from -1 to 1.
function pointOf(box, along, across) {
  const [forward, left] = [along * box.halfLength, across * box.halfWidth];
  return [box.x + forward * box.cos - left * box.sin, box.y + forward * box.sin + left * box.cos];
}

const BOX_CORNERS = [[1, 1], [1, -1], [-1, -1], [-1, 1]];

function cornersOf(box) {
  return BOX_CORNERS.map(([along, across]) => pointOf(box, along, across));
}

// The point of a box nearest to another point.
function nearestOf(box, x, y) {
  const [dx, dy] = [x - box.x, y - box.y];
  const limited = (value, half) => Math.min(Math.max(value, -half), half) / Math.max(half, 1e-9);
  return pointOf(
    box,
    limited(dx * box.cos + dy * box.sin, box.halfLength),
    limited(dy * box.cos - dx * box.sin, box.halfWidth),
  );
}

// Where two boxes touch: midway between the points of each that are nearest to the other's centre.
function contactOf(one, other) {
  const [x, y] = nearestOf(one, other.x, other.y);
  const [u, v] = nearestOf(other, one.x, one.y);
  return [(x + u) / 2, (y + v) / 2];
}

// The first most critical instant of a course; null if it is constant.
function mostCriticalInstant(course, lowerIsCritical) {
  let best = null;
  let same = true;
  for (let k = 0; k < (course?.length ?? 0); k++) {
    if (Number.isNaN(course[k])) continue;
    if (best === null) best = k;
    else if (course[k] !== course[best]) {
      same = false;
      if (lowerIsCritical ? course[k] < course[best] : course[k] > course[best]) best = k;
    }
  }
  return same ? null : best;
}
