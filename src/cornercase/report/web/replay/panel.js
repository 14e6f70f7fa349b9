"use strict";

// A motion this many times as long as wide is shown in a low box.
const FLAT = 2;

// The replay: the selected scenario on its road, another one beside it, and below them events and courses over time.
class ReplayPanel {
  constructor(section, store, recordings) {
    Object.assign(this, { section, store, recordings });
    this.clock = new ReplayClock(() => this.changed());
    this.camera = new ReplayCamera(() => this.changed());
    this.sight = true;
    this.expected = true;
    this.waiting = false;
    this.colours = null;
    this.never = true;
    this.roads = undefined;
    this.road = null;
    this.shown = { selected: null, beside: null };
    this.panes = { selected: new ReplayPane("selected", this), beside: new ReplayPane("beside", this) };
    this.controls = new ReplayControls(this);
    const seek = (time) => {
      this.clock.pause();
      this.clock.seek(time);
    };
    this.chart = new CourseChart(newElement("canvas", "course"), seek);
    this.events = new EventsLine(seek);
    this.build();
    store.on("selected", () => this.follow());
    store.on("contents", () => {
      this.takeRoad();
      for (const pane of Object.values(this.panes)) if (store.rows.has(pane.id)) pane.describe();
      // A study that was empty at first shows its first scenario when it arrives.
      if (this.never && store.selected === null) store.select(mostCriticalScenario(store));
      this.follow();
    });
    store.on("options", () => this.choose());
    // Failed requests are repeated when the server is back; scenarios of another study have the same ids.
    store.on("served", () => this.follow((pane) => pane.trouble !== null));
    store.on("replaced", () => this.follow((pane) => pane.id !== null));
    store.on("theme", () => this.recolour());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    // Paper is white, and printed before the next frame.
    addEventListener("beforeprint", () => {
      this.colours = null;
      this.draw();
    });
    addEventListener("afterprint", () => this.recolour());
    listenToKeys(section, this);
    this.ready = this.follow();
  }

  build() {
    this.box = newElement("div", "replay-panel");
    this.nothing = newElement("p", "replay-empty", "Click a point, or pick a scenario in the table, to see it drive.");
    this.scenes = newElement("div", "replay-scenes");
    this.scenes.append(this.panes.selected.box, this.panes.beside.box);
    this.chart.canvas.setAttribute("role", "img");
    this.legend = newElement("p", "replay-legend");
    this.notice = newElement("p", "replay-notice");
    this.notice.hidden = true;
    this.takeRoad();
    this.tables = newElement("div", "replay-tables");
    this.tables.append(this.panes.selected.values, this.panes.beside.values);
    this.lack = newElement("p", "replay-notice", this.store.contents.expected?.missing ?? "");
    this.lack.hidden = !this.lack.textContent;
    this.box.append(this.scenes, this.controls.box, this.events.box, this.chart.canvas, this.legend, this.tables, this.notice, this.lack);
    this.section.append(this.nothing, this.box);
    new ResizeObserver(() => this.changed()).observe(this.chart.canvas);
  }

  // The road arrives with the first analysis of a live study, and grows with its region.
  takeRoad() {
    const { roads, roads_missing: missing } = this.store.contents;
    if (roads === this.roads) return;
    this.roads = roads;
    this.road = roads ? new RoadDrawing(roads) : null;
    this.notice.textContent = roads ? "" : missing ?? "";
    this.notice.hidden = !this.notice.textContent;
    this.changed();
  }

  empty() {
    return !this.panes.selected.recording && !this.panes.beside.recording;
  }

  metric() {
    const { metrics } = this.store.contents;
    return metrics.find((one) => one.name === this.store.options.metric) ?? metrics[0];
  }

  // Shows the selection of the store, and repeats panes on request.
  async follow(again = () => false) {
    const { store, panes } = this;
    const before = this.shown;
    if (store.selected !== null) this.never = false;
    this.shown = { selected: store.selected, beside: store.beside ?? this.expectedRun() };
    const changed = Object.keys(panes).filter((slot) => before[slot] !== this.shown[slot] || again(panes[slot]));
    this.nothing.hidden = store.selected !== null || store.beside !== null;
    this.box.hidden = !this.nothing.hidden;
    if (!changed.length) return;
    await Promise.all(changed.map((slot) => panes[slot].show(this.shown[slot])));
    this.box.classList.toggle("two", this.shown.selected !== null && this.shown.beside !== null);
    this.choose();
    if (changed.includes("selected") || panes.selected.recording === null) this.goTo("critical");
    if (this.camera.mode === "near" || this.camera.mode === "all") this.fit(this.camera.mode);
    else if (this.camera.mode === "free" && !this.inSight()) this.fit("near");
  }

  // Whether the most critical instant is in view.
  inSight() {
    return this.there().every((pane) => {
      const box = pane.boxOfEgo(this.clock.time);
      if (!box) return true;
      const { x, y } = pane.toPixels(box.x, box.y);
      const { width, height } = pane.size();
      return x > 0 && y > 0 && x < width && y < height;
    });
  }

  there() {
    return Object.values(this.panes).filter((pane) => pane.recording);
  }

  // Parts that depend on the metric, the aspect and the selection.
  choose() {
    const there = this.there();
    for (const pane of Object.values(this.panes)) if (pane.id !== null) pane.describe();
    if (there.length) {
      const end = Math.max(...there.map(({ recording }) => recording.time[recording.time.length - 1]));
      this.clock.setTimes(there[0].recording.time, end);
      const metric = this.metric();
      const { critical, searched } = this.store.contents;
      // A weighted sum has a threshold, but no course.
      const threshold = critical && metric.name === searched ? critical.threshold : null;
      const lines = there.map(({ slot, id, recording }) => ({
        slot,
        name: this.called(id),
        events: eventsOf(this.store, id, recording),
        fault: faultOf(this.store, id, recording),
      }));
      const panels = this.coursePanels(there, metric, threshold);
      this.events.show(lines, this.colours);
      this.chart.setCourses(panels, this.clock.begin, this.clock.end, lines);
      const titles = panels.map(({ title }) => title).join(", ");
      this.chart.canvas.setAttribute(
        "aria-label",
        `Courses over time [s] of ${there.map((pane) => this.called(pane.id)).join(" and ")}: ${titles}`,
      );
      this.tellLegend(there);
    }
    if (!there.length) this.events.box.hidden = true;
    this.controls.box.hidden = this.chart.canvas.hidden = this.legend.hidden = !there.length;
    this.changed();
  }

  // Courses of the shown scenarios: what the ego did, the gap to the other, and the metric.
  coursePanels(there, metric, threshold) {
    const panel = (title, valuesOf, more = {}) => {
      const courses = there
        .map((pane) => ({ slot: pane.slot, time: pane.recording.time, values: valuesOf(pane) }))
        .filter(({ values }) => values);
      return { title, courses, threshold: null, ...more };
    };
    const ego = unturned(shortName([this.store.contents.ego].flat()[0]));
    const others = [...new Set(there.filter((pane) => pane.other >= 0).map((pane) => pane.recording.names[pane.other]))];
    const whom = others.length === 1 ? unturned(shortName(others[0])) : "the other";
    const unit = metric.unit && metric.unit !== "1" ? ` [${metric.unit}]` : "";
    const has = (pane) => pane.ego >= 0;
    return [
      panel(`speed of ${ego} [m/s]`, (pane) => has(pane) && pane.recording.speed[pane.ego], { low: 0 }),
      panel(`acceleration of ${ego} [m/s²]`, (pane) => has(pane) && pane.recording.acceleration[pane.ego]),
      panel(
        `gap to ${whom} [m]`,
        (pane) => has(pane) && pane.other >= 0 && gapsOf(pane.recording, pane.ego, pane.other),
        { low: 0, high: LARGEST_GAP },
      ),
      panel(`${unturned(metric.name)}${unit}`, (pane) => pane.recording.courses[metric.name], { threshold }),
    ].filter(({ courses }) => courses.length);
  }

  // As a sentence.
  called(id) {
    if (this.store.contents.expected?.runs[-id]) return "the expected run";
    return ownName(this.store, id) ?? `scenario ${id}`;
  }

  tellLegend(there) {
    const marks = there.map(({ slot, id }) => {
      const mark = newElement("span", "replay-mark", this.called(id));
      mark.dataset.slot = slot;
      return mark;
    });
    this.legend.replaceChildren(...marks);
  }

  goTo(where) {
    const pane = this.there()[0];
    if (!pane) return;
    this.clock.pause();
    this.clock.seek({ start: this.clock.begin, end: this.clock.end }[where] ?? pane.criticalTime());
  }

  fit(mode) {
    const there = this.there();
    const near = there.map((pane) => pane.region(false)).filter(Boolean);
    if (!near.length) return;
    const around = there.map((pane) => pane.regionAlong());
    const along = around.every(Boolean);
    const closest = unionOf(along ? around : near);
    // A long and narrow view that goes along fills a low box; the height must be set before it is measured.
    this.box.classList.toggle("flat", along && closest[2] - closest[0] > FLAT * (closest[3] - closest[1]));
    const { width, height } = there[0].size();
    const whole = mode === "all" ? unionOf(there.map((pane) => pane.region(true)).filter(Boolean)) : closest;
    // Labels need some room at any scale.
    const [wide, high] = [Math.max(width - 60, 50), Math.max(height - 60, 50)];
    const least = Math.max(0, 22 - Math.max(whole[2] - whole[0], whole[3] - whole[1])) / 2;
    const grown = [whole[0] - least, whole[1] - least, whole[2] + least, whole[3] + least];
    this.camera.fit(grown, wide || 400, high || 300, mode, mode === "near" && along);
  }

  toggleFollow() {
    this.camera.follow(!this.camera.follows, this.there()[0]?.boxOfEgo(this.clock.time));
  }

  toggleSight() {
    this.sight = !this.sight;
    this.changed();
  }

  toggleNeighbour() {
    const { store } = this;
    // In a comparison the partner is shown beside a scenario.
    if (store.contents.called) return;
    if (store.beside !== null) store.select(null, "beside");
    else store.select(neighbourOf(store, store.selected, (id) => this.recordings.has(id)), "beside");
  }

  // Of a run of a suite: the earlier run of the selected scenario, which has the negative id; null without.
  expectedRun() {
    const { selected, contents } = this.store;
    return this.expected && selected !== null && contents.expected?.runs[selected] ? -selected : null;
  }

  toggleExpected() {
    this.expected = !this.expected;
    if (this.store.beside !== null) {
      this.expected = true;
      this.store.select(null, "beside");
    }
    this.follow();
  }

  recolour() {
    this.colours = null;
    this.changed();
  }

  // Draws once before the next frame, however often it is called.
  changed() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    if (this.colours === null) {
      const colours = sceneColours(this.box);
      this.colours = { ...colours, selected: colours.ego, beside: colours.other };
      this.events.paint(this.colours);
    }
    for (const pane of this.there()) pane.draw(this.clock.time, this.colours);
    if (!this.empty()) {
      this.chart.draw(this.clock.time, this.colours);
      this.controls.update();
    }
  }
}

function unionOf(regions) {
  return regions.reduce(([left, bottom, right, top], one) => [
    Math.min(left, one[0]), Math.min(bottom, one[1]), Math.max(right, one[2]), Math.max(top, one[3]),
  ]);
}

// Starts the replay, by default with the most critical scenario.
function showReplay(section, store, recordings) {
  if (store.selected === null) store.select(mostCriticalScenario(store));
  const panel = new ReplayPanel(section, store, recordings);
  const replay = {
    panel,
    clock: panel.clock,
    ready: panel.ready,
    seek: (time) => panel.clock.seek(time),
    toPixels: (slot, x, y) => panel.panes[slot].toPixels(x, y),
  };
  window.cornercase = { ...window.cornercase, replay };
  return replay;
}
