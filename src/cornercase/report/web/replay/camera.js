"use strict";

// The visible part of the plane. All scenes share it, so that lengths are comparable.
//
// Modes: "near" (where the two come close), "all", "follow" (the ego stays in the centre), "free". Where the two drive
// along together, as on a motorway, "near" moves with the ego, too.
const CLOSEST_SCALE = 200;
const WIDEST_SCALE = 0.05;

class ReplayCamera {
  constructor(changed) {
    this.changed = changed;
    this.mode = "near";
    this.along = false;
    this.x = 0;
    this.y = 0;
    this.scale = 8;
  }

  // Whether the view moves with the ego: x and y are then from the ego.
  get follows() {
    return this.mode === "follow" || (this.mode === "near" && this.along);
  }

  // Pixels per metre and the centre of the view; `ego` is its box in that scene, if it exists.
  view(ego) {
    if (this.follows && ego) return { x: ego.x + this.x, y: ego.y + this.y, scale: this.scale };
    return { x: this.x, y: this.y, scale: this.scale };
  }

  // Shows a region [left, bottom, right, top], with `along` one around the ego, in scenes of this size in pixels.
  fit([left, bottom, right, top], width, height, mode, along = false) {
    this.mode = mode;
    this.along = along;
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    this.setScale(Math.min(width / Math.max(right - left, 1), height / Math.max(top - bottom, 1)));
    this.changed();
  }

  follow(on, ego) {
    if (on) {
      this.mode = "follow";
      this.x = this.y = 0;
      this.setScale(Math.max(this.scale, 6));
    } else {
      if (ego && this.follows) {
        this.x += ego.x;
        this.y += ego.y;
      }
      this.mode = "free";
    }
    this.changed();
  }

  setScale(scale) {
    this.scale = Math.min(Math.max(scale, WIDEST_SCALE), CLOSEST_SCALE);
  }

  // Zooms around a point given in pixels right of and below the centre, which stays fixed.
  zoom(factor, right = 0, below = 0) {
    const before = this.scale;
    this.setScale(before * factor);
    if (this.follows) {
      this.mode = "follow";
    } else {
      this.mode = "free";
      this.x += right / before - right / this.scale;
      this.y -= below / before - below / this.scale;
    }
    this.changed();
  }

  pan(right, down) {
    this.mode = this.follows ? "follow" : "free";
    this.x -= right / this.scale;
    this.y += down / this.scale;
    this.changed();
  }
}

// Mouse, wheel and touch move the view of a canvas. One finger scrolls the page as usual; two fingers zoom.
function moveByPointer(canvas, camera) {
  const pointers = new Map();
  const middleOf = () => {
    const all = [...pointers.values()];
    const mean = (name) => all.reduce((sum, one) => sum + one[name], 0) / all.length;
    const apart = all.length > 1 ? Math.hypot(all[0].x - all[1].x, all[0].y - all[1].y) : 0;
    return { x: mean("x"), y: mean("y"), apart };
  };
  const fromMiddle = (x, y) => {
    const place = canvas.getBoundingClientRect();
    return [x - place.left - place.width / 2, y - place.top - place.height / 2];
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = middleOf();
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const after = middleOf();
    if (before.x !== after.x || before.y !== after.y) camera.pan(after.x - before.x, after.y - before.y);
    if (before.apart > 0 && after.apart > 0) camera.zoom(after.apart / before.apart, ...fromMiddle(after.x, after.y));
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener(
    "wheel",
    (event) => {
      // The wheel scrolls the page unless a key is pressed or the scene was clicked.
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== canvas) return;
      event.preventDefault();
      const turned = Math.min(Math.max(event.deltaY, -60), 60);
      camera.zoom(Math.exp(-turned / 200), ...fromMiddle(event.clientX, event.clientY));
    },
    { passive: false },
  );
}
