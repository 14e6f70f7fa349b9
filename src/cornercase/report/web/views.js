"use strict";

// Views of the scenarios, each in a box of its own. A view is an object with
//   name, title, about (what to see in it), wanted(store) (whether there is something to see),
//   create(box, store) -> redraw(event, detail), which is called with the events of the store, only while the box is
//   on the screen; what happened meanwhile is made up for with one event "contents" when it gets there.
const VIEWS = [];

const EVENTS = ["contents", "shown", "selected", "options", "theme"];

function showViews(place, store) {
  for (const view of VIEWS) {
    if (!view.wanted(store)) continue;
    const box = document.createElement("figure");
    box.className = "view";
    box.id = `view-${view.name}`;
    const title = document.createElement("h3");
    title.textContent = view.title;
    const inner = document.createElement("div");
    inner.className = "drawing";
    const caption = document.createElement("figcaption");
    caption.textContent = typeof view.about === "function" ? view.about(store) : view.about;
    box.append(title, inner, caption);
    place.append(box);
    keepDrawn(view, box, inner, store);
  }
}

function keepDrawn(view, box, inner, store) {
  let redraw = null;
  let onScreen = false;
  let late = false;
  const observer = new IntersectionObserver(
    (entries) => {
      onScreen = entries[entries.length - 1].isIntersecting;
      if (!onScreen) return;
      if (redraw === null) redraw = view.create(inner, store);
      else if (late) redraw("contents");
      late = false;
    },
    { rootMargin: "200px" },
  );
  observer.observe(box);
  for (const event of EVENTS) {
    store.on(event, (detail) => {
      if (redraw !== null && onScreen) redraw(event, detail);
      else late = true;
    });
  }
}
