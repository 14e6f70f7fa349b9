"use strict";

// Views of the scenarios, each in a box of its own. A view is an object with
//   name, title, about (what to see in it, in a line), more (the same at length, told on demand),
//   wanted(store) (whether there is something to see), wide (the whole row),
//   finding (what was found in it, in the contents' captions, is told with `more`),
//   known (it shows what is known of all scenarios together, which follows later while a study grows),
//   heavy (to be drawn only when it is seen or printed),
//   create(box, store) -> { redraw(events) }, where `events` are the store's since it last drew.
// All views draw in one frame after a change, those off the screen when they get there.
const VIEWS = [];

const EVENTS = ["contents", "shown", "selected", "options", "hovered", "notes", "theme"];

class Views {
  constructor(place, store) {
    this.place = place;
    this.store = store;
    this.boxes = new Map();
    this.frame = null;
    this.drawn = [];
    this.observer = new IntersectionObserver((entries) => this.moved(entries), { rootMargin: "120px" });
    for (const event of EVENTS) store.on(event, () => this.late(event));
    this.makeBoxes();
    addEventListener("beforeprint", () => this.print());
    addEventListener("afterprint", () => this.late("contents"));
  }

  // Some views appear later: a growing study is analyzed later.
  makeBoxes() {
    const { place, store, boxes } = this;
    VIEWS.forEach((view, order) => {
      if (boxes.has(view.name) || !view.wanted(store)) return;
      const box = document.createElement("figure");
      box.className = view.wide ? "view wide" : "view";
      box.id = `view-${view.name}`;
      box.style.order = order;
      const title = document.createElement("h3");
      title.textContent = view.title;
      const caption = makeCaption(view.title);
      const inner = document.createElement("div");
      inner.className = "drawing";
      box.append(title, caption.box, inner);
      const next = [...boxes.values()].find((each) => each.order > order);
      place.insertBefore(box, next?.box ?? null);
      boxes.set(view.name, { view, box, inner, caption, order, made: null, onScreen: false, events: new Set() });
      this.tellAbout(boxes.get(view.name));
      this.observer.observe(box);
    });
    this.fillRows();
  }

  // A view that is alone in its row is full width.
  fillRows() {
    let run = [];
    const end = () => {
      run.forEach(({ box }, k) => box.classList.toggle("wide", run.length % 2 === 1 && k === run.length - 1));
      run = [];
    };
    for (const one of [...this.boxes.values()].sort((a, b) => a.order - b.order)) {
      if (one.view.wide) end();
      else run.push(one);
    }
    end();
  }

  tellAbout({ view, caption }) {
    const textOf = (text) => (typeof text === "function" ? text(this.store) : text);
    let told = view.finding ? this.store.contents.captions?.[view.name] : null;
    // Some captions depend on the metric or the aspect.
    if (told && typeof told === "object") {
      const { metric, aspect } = this.store.options;
      told = told[[metric, aspect].find((name) => Object.hasOwn(told, name))];
    }
    const known = told || view.known ? knownOf(this.store) : null;
    const first = known === null ? "" : `Of the first ${known} scenarios`;
    caption.line.textContent = joined(textOf(view.about), first && !told && `${first}.`);
    caption.text.textContent = joined(textOf(view.more), first && told && `${first}:`, told);
    caption.more.hidden = !caption.text.textContent;
  }

  moved(entries) {
    for (const entry of entries) {
      const one = [...this.boxes.values()].find(({ box }) => box === entry.target);
      one.onScreen = entry.isIntersecting;
    }
    this.schedule();
  }

  late(event) {
    if (event === "contents") this.makeBoxes();
    for (const one of this.boxes.values()) {
      one.events.add(event);
      if (event === "contents" || event === "options") this.tellAbout(one);
    }
    this.schedule();
  }

  schedule() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      for (const one of this.boxes.values()) if (one.onScreen) this.draw(one);
      for (const resolve of this.drawn.splice(0)) resolve();
    });
  }

  draw(one) {
    if (one.made === null) {
      one.made = one.view.create(one.inner, this.store);
      one.events = new Set(["contents"]);
    }
    if (!one.events.size) return;
    const { events } = one;
    one.events = new Set();
    one.made.redraw(events);
  }

  // For keyboard users, each view must have focusable content before it was ever visible.
  makeAll(done) {
    const missing = [...this.boxes.values()].find((one) => one.made === null && !one.view.heavy);
    if (!missing) return done();
    whenIdle(() => {
      if (missing.made === null) this.draw(missing);
      this.makeAll(done);
    });
  }

  drawAll() {
    for (const one of this.boxes.values()) this.draw(one);
  }

  // Resolves when everything visible shows the last change.
  settled() {
    this.schedule();
    return new Promise((resolve) => this.drawn.push(resolve));
  }

  // Printing needs a finer resolution, and also views that were never visible.
  print() {
    this.drawAll();
    for (const plot of PRINTED) {
      if (plot.measure(3)) plot.redraw(new Set(["contents"]), true);
    }
  }

  get(name) {
    return this.boxes.get(name)?.made ?? null;
  }
}

// A caption of a line, with more on demand.
function makeCaption(title) {
  const box = document.createElement("figcaption");
  const [line, more, summary, text] = ["span", "details", "summary", "p"].map((tag) => document.createElement(tag));
  summary.textContent = "More";
  summary.setAttribute("aria-label", `More about: ${title}`);
  more.append(summary, text);
  box.append(line, " ", more);
  return { box, line, more, text };
}

function joined(...parts) {
  return parts.filter(Boolean).join(" ");
}

function whenIdle(work) {
  if (window.requestIdleCallback) requestIdleCallback(work, { timeout: 500 });
  else setTimeout(work, 30);
}
