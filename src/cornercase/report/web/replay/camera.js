"use strict";

// Which part of the plane is shown. All scenes share it, so that what is as long looks as long.
//
// Modes: "near" (where the two come near each other), "all", "follow" (the ego stays in the middle), "free".
const CLOSEST_SCALE = 200;
const WIDEST_SCALE = 0.05;

class ReplayCamera {
  constructor(changed) {
    this.changed = changed;
    this.mode = "near";
    this.x = 0;
    this.y = 0;
    this.scale = 8;
  }

  // Pixels by metre and the middle of what is shown; `ego` is its box in that scene, where it exists.
  view(ego) {
    if (this.mode === "follow" && ego) return { x: ego.x + this.x, y: ego.y + this.y, scale: this.scale };
    return { x: this.x, y: this.y, scale: this.scale };
  }

  // Shows a region [left, bottom, right, top] in scenes of so many pixels.
  fit([left, bottom, right, top], width, height, mode) {
    this.mode = mode;
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
      if (ego && this.mode === "follow") {
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

  // Zooms about a point that is so many pixels right of and below the middle, where the plane stays as it is.
  zoom(factor, right = 0, below = 0) {
    const before = this.scale;
    this.setScale(before * factor);
    if (this.mode !== "follow") {
      this.mode = "free";
      this.x += right / before - right / this.scale;
      this.y -= below / before - below / this.scale;
    }
    this.changed();
  }

  pan(right, down) {
    if (this.mode !== "follow") this.mode = "free";
    this.x -= right / this.scale;
    this.y += down / this.scale;
    this.changed();
  }
}

// Mouse, wheel and touch move what a canvas shows. One finger scrolls the page up and down, as everywhere; two zoom.
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
      // The page scrolls on, unless one means the scene: by a key, or by having clicked into it.
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== canvas) return;
      event.preventDefault();
      const turned = Math.min(Math.max(event.deltaY, -60), 60);
      camera.zoom(Math.exp(-turned / 200), ...fromMiddle(event.clientX, event.clientY));
    },
    { passive: false },
  );
}
