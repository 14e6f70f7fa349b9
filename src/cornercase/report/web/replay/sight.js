"use strict";

// What the ego sees: the eye and the five points of a box, as in the visibility rule of the drivers.
// Boxes have no height: every entity hides what is behind it, unless it surrounds the eye.

// Position of the eye ahead of the box centre, as a share of its length.
const EYE_AHEAD = 0.25;
// Length of a shadow in m: beyond everything that is drawn.
const SHADOW_REACH = 2000;

function eyeOf(box) {
  return pointOf(box, 2 * EYE_AHEAD, 0);
}

// Whether the line from the eye to a point meets a box (slab method).
function hides(box, [eyeX, eyeY], [x, y]) {
  const from = [eyeX - box.x, eyeY - box.y];
  const way = [x - eyeX, y - eyeY];
  let enters = 0;
  let leaves = 1;
  let inside = true;
  for (const [cos, sin, half] of [[box.cos, box.sin, box.halfLength], [-box.sin, box.cos, box.halfWidth]]) {
    const start = from[0] * cos + from[1] * sin;
    const step = way[0] * cos + way[1] * sin;
    if (Math.abs(start) > half) inside = false;
    if (step === 0) {
      if (Math.abs(start) > half) return false;
    } else {
      const [one, other] = [(-half - start) / step, (half - start) / step];
      enters = Math.max(enters, Math.min(one, other));
      leaves = Math.min(leaves, Math.max(one, other));
    }
  }
  return enters < leaves && !inside;
}

// Whether a driver sees an entity: one of its corners or its centre, with no third one between.
function sees(boxes, driver, target) {
  const [own, seen] = [boxes[driver], boxes[target]];
  if (!own || !seen) return null;
  const eye = eyeOf(own);
  const between = boxes.filter((box, k) => box && k !== driver && k !== target);
  return [...cornersOf(seen), [seen.x, seen.y]].some((point) => between.every((box) => !hides(box, eye, point)));
}

// The area behind a box as seen from the eye; null if the eye is inside it.
function shadowOf(box, [eyeX, eyeY]) {
  const [dx, dy] = [box.x - eyeX, box.y - eyeY];
  const angles = cornersOf(box).map(([x, y]) => {
    const [u, v] = [x - eyeX, y - eyeY];
    return { x, y, u, v, angle: Math.atan2(dx * v - dy * u, dx * u + dy * v) };
  });
  angles.sort((one, other) => one.angle - other.angle);
  const [right, left] = [angles[0], angles[angles.length - 1]];
  if (left.angle - right.angle >= Math.PI || (dx === 0 && dy === 0)) return null;
  const far = ({ u, v }) => {
    const reach = SHADOW_REACH / Math.max(Math.hypot(u, v), 1e-9);
    return [eyeX + u * reach, eyeY + v * reach];
  };
  return [[right.x, right.y], far(right), far(left), [left.x, left.y]];
}
