"use strict";

// A live page loads all contents from its server, then receives events.

// Every request contains the token of the page's address.
function servedAt(path, more = {}) {
  const address = new URL(path, location.href);
  address.hash = "";
  address.search = "";
  const token = new URLSearchParams(location.search).get("token");
  for (const [name, value] of Object.entries({ token: token ?? "", ...more })) address.searchParams.set(name, value);
  return address.href;
}

function isLive() {
  return document.documentElement.dataset.live === "true";
}

// The study may have been replaced before a request arrives.
function ofStudy(store) {
  return { epoch: epochOf(store.contents) };
}

// Why the server returned nothing, as a sentence for the reader.
class ServerError extends Error {}

// The response of the server, read as "json", "text", "blob" or "arrayBuffer".
async function ask(path, read, more = {}, options = {}) {
  let answer = null;
  let content = null;
  try {
    answer = await fetch(servedAt(path, more), options);
    content = await answer[answer.ok ? read : "text"]();
  } catch (error) {
    // This is how browsers report a missing or broken connection.
    if (!(error instanceof TypeError)) throw error;
    throw new ServerError("The server does not answer.");
  }
  if (!answer.ok) throw new ServerError(content.trim());
  return content;
}

async function fetchContents() {
  const contents = await ask("contents", "json");
  // As arrays that can grow.
  for (const course of Object.values(contents.courses ?? {})) {
    const bytes = await unpack(course.values);
    course.values = new Uint16Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 2);
  }
  return contents;
}

// Waits for the server, and until a scenario has ended.
async function firstContents() {
  const state = new LiveState();
  for (;;) {
    try {
      const contents = await fetchContents();
      if (contents.format) return contents;
      state.show(contents.live);
    } catch (error) {
      if (!(error instanceof ServerError)) throw error;
      state.showStopped(error.message);
    }
    await new Promise((resolve) => setTimeout(resolve, 500));
  }
}

// Text of the header.
class LiveState {
  constructor() {
    this.box = document.getElementById("live-state");
    if (this.box === null) {
      this.box = document.createElement("p");
      this.box.id = "live-state";
      document.getElementById("tools").before(this.box);
    }
  }

  show(state) {
    this.box.dataset.state = state.name;
    if (state.name === "waiting" || state.run + state.failed === 0) {
      this.box.dataset.state = "waiting";
      this.box.textContent = `waiting: ${state.why || "no scenario has ended yet."}`;
      return;
    }
    const parts = [`live: ${state.run} scenarios`];
    if (state.failed) parts.push(`${state.failed} failed`);
    if (state.pending) parts.push(`${state.pending} pending`);
    // Always 24 hours, so that the width is the same in each locale.
    if (state.last) parts.push(`last ${new Date(1000 * state.last).toLocaleTimeString("en-GB")}`);
    this.box.textContent = parts.join(", ");
  }

  showStopped(why = "The server does not answer.") {
    this.box.dataset.state = "stopped";
    this.box.textContent = `stopped: ${why} It is asked again each second.`;
  }
}

// Recordings of the server; the last few are cached.
class ServedRecordings {
  constructor(store) {
    this.store = store;
    this.known = new Map();
  }

  // The store knows which scenarios have a recording.
  has(id) {
    const row = this.store.rows.get(id);
    return row !== undefined && !this.store.contents.scenarios.failed[row];
  }

  async get(id) {
    if (!this.has(id)) return null;
    if (!this.known.has(id)) {
      const coming = this.fetch(id);
      this.known.set(id, coming);
      if (this.known.size > 64) this.known.delete(this.known.keys().next().value);
      // A failed request is repeated the next time the recording is needed.
      coming.catch(() => this.known.get(id) === coming && this.known.delete(id));
    }
    return this.known.get(id);
  }

  async fetch(id) {
    const recording = readRecord(await inflate(await ask(`recordings/${id}`, "arrayBuffer", ofStudy(this.store))));
    this.fetchEvents(id, recording);
    return recording;
  }

  // What happened when follows: finding it takes longer than to read the recording.
  async fetchEvents(id, recording) {
    try {
      recording.events = await ask(`scenarios/${id}/events`, "json", ofStudy(this.store));
    } catch (error) {
      // The replay does without; the server may have ended, or the study may be another one by now.
      if (!(error instanceof ServerError)) throw error;
      return;
    }
    window.cornercase?.replay?.panel.choose();
  }

  forget() {
    this.known.clear();
  }
}

// Keeps the store in sync with the study.
class Following {
  constructor(store, recordings) {
    this.store = store;
    this.recordings = recordings;
    this.state = new LiveState();
    // Received events that are not shown yet, as [event, data].
    this.told = [];
    this.waiting = null;
    this.cost = 0;
    this.fetching = false;
    this.again = false;
    this.cursor = store.contents.live.cursor;
    this.begin();
    // A browser opens six connections to a server; hidden pages leave them to the others.
    document.addEventListener("visibilitychange", () => {
      this.events.close();
      if (!document.hidden) this.begin();
    });
    this.showState(store.contents.live);
    this.showKnowledge(store.contents);
  }

  begin() {
    const events = new EventSource(servedAt("events", { since: this.cursor }));
    this.events = events;
    const on = (name, act) =>
      events.addEventListener(name, (event) => {
        this.cursor = event.lastEventId || this.cursor;
        act(JSON.parse(event.data));
      });
    // The study that is shown may have been replaced.
    const same = () => this.cursor.split(".")[0] === epochOf(this.store.contents);
    for (const name of ["scenarios", "knowledge", "state"]) {
      on(name, (data) => (same() ? this.add(name, data) : this.fetchAgain()));
    }
    on("contents", () => this.fetchAgain());
    on("notes", (notes) => this.store.setNotes(notes));
    events.onopen = () => {
      if (this.last) this.state.show(this.last);
      this.store.tell("served");
    };
    // The browser reconnects by itself unless the server refused the connection.
    events.onerror = () => {
      this.state.showStopped();
      if (events.readyState !== EventSource.CLOSED) return;
      setTimeout(() => this.events === events && this.begin(), 1000);
    };
  }

  // Events in quick succession are shown together: redrawing a large study takes longer than receiving a scenario.
  add(name, data) {
    this.told.push([name, data]);
    this.waiting ??= setTimeout(() => {
      this.waiting = null;
      if (this.fetching) return;
      const begun = performance.now();
      this.show();
      this.cost = performance.now() - begun;
    }, Math.min(1000, Math.max(100, 3 * this.cost)));
  }

  // Shows scenarios, counts and analysis in one step, so that all numbers belong to one moment.
  show() {
    const { store } = this;
    // Batches that continue at once wait for the rest.
    const last = this.told.findLastIndex(([name, data]) => name !== "scenarios" || data.state !== null);
    const told = this.told.splice(0, last + 1);
    if (!told.length) return;
    const of = (wanted) => told.filter(([name]) => name === wanted).map(([, data]) => data);
    const knowledge = of("knowledge").at(-1);
    const contents = addRows(store, of("scenarios"));
    if (contents !== null || knowledge) store.setContents({ ...(contents ?? store.contents), ...knowledge });
    this.showState(told.map(([name, data]) => (name === "state" ? data : data.state)).filter(Boolean).at(-1));
    this.showKnowledge(knowledge ?? {});
  }

  // A state with other counts belongs to another moment; the right one will come.
  showState(state) {
    if (!state || (state.name !== "waiting" && state.run + state.failed !== this.store.n)) return;
    this.last = state;
    this.state.show(state);
  }

  async fetchAgain() {
    this.again = true;
    // All previous events are included in the contents requested now.
    this.told = [];
    if (this.fetching) return;
    this.fetching = true;
    try {
      while (this.again) {
        this.again = false;
        const contents = await fetchContents();
        if (contents.format) this.take(contents);
        else this.state.show(contents.live);
      }
    } catch (error) {
      if (!(error instanceof ServerError)) throw error;
      this.state.showStopped(error.message);
      // The server does not repeat events this page should have.
      setTimeout(() => this.fetchAgain(), 1000);
    } finally {
      this.fetching = false;
    }
    // Events received meanwhile; most are in the contents already.
    if (this.told.length) this.add(...this.told.pop());
  }

  take(contents) {
    const { store } = this;
    const about = ({ parameters, metrics }) => JSON.stringify([parameters, metrics]);
    // A different study is there now, which the views do not know.
    if (about(contents) !== about(store.contents)) {
      location.reload();
      return;
    }
    // A restarted search reuses scenario ids.
    const isOther = epochOf(contents) !== epochOf(store.contents);
    if (isOther) this.recordings.forget();
    store.setContents(contents);
    if (isOther) store.tell("replaced");
    this.showState(contents.live);
    this.showKnowledge(contents);
  }

  // The analysis follows in the background; until it is up to date, its number of scenarios is shown.
  showHowOld() {
    const { store } = this;
    const known = knownOf(store);
    const text = known === null ? "" : `Of the first ${known} of ${store.n} scenarios; the others follow.`;
    for (const part of ["answers", "details", "provenance"]) {
      const title = document.getElementById(`${part}-title`);
      let box = title.parentElement.querySelector(".how-old");
      if (box === null) {
        box = document.createElement("p");
        box.className = "how-old";
        title.after(box);
      }
      box.textContent = text;
      box.hidden = !text;
    }
  }

  showKnowledge({ title, about, answers, details, provenance }) {
    this.showHowOld();
    if (title) {
      document.querySelector("#top h1").textContent = title;
      document.title = `cornercase: ${title}`;
    }
    if (about) document.getElementById("about").textContent = about;
    if (answers) showAnswers(answers);
    if (details) showDetails(details);
    const made = document.getElementById("made");
    if (provenance && made) made.replaceChildren(...parsed(provenance));
  }
}

// Identifies the study among all that the server has seen.
function epochOf(contents) {
  return contents.live.cursor.split(".")[0];
}

// The contents with new rows; null if there are none.
function addRows(store, told) {
  const { contents } = store;
  const known = new Set(store.rows.keys());
  const fresh = [];
  for (const one of told) {
    one.scenarios.id.forEach((id, k) => {
      if (known.has(id)) return;
      known.add(id);
      fresh.push([one, k]);
    });
  }
  if (!fresh.length) return null;
  const more = (name) => fresh.map(([one, k]) => one.scenarios[name][k]);
  const old = contents.scenarios;
  const scenarios = {};
  for (const [name, column] of Object.entries(old)) {
    if (name === "values") {
      scenarios.values = column.map((each, j) => each.concat(fresh.map(([one, k]) => one.scenarios.values[j][k])));
    } else if (name === "scores") {
      const of = (metric) => fresh.map(([one, k]) => one.scenarios.scores[metric][k]);
      scenarios.scores = Object.fromEntries(Object.entries(column).map(([key, each]) => [key, each.concat(of(key))]));
    } else {
      scenarios[name] = column.concat(more(name));
    }
  }
  const nothing = new Array(fresh.length).fill(null);
  const kinds = {};
  for (const [name, one] of Object.entries(contents.kinds)) {
    const embedding = one.embedding.map((column) => column.concat(nothing));
    kinds[name] = { ...one, labels: one.labels.concat(nothing), embedding };
  }
  const courses = {};
  for (const [name, one] of Object.entries(contents.courses)) {
    courses[name] = addCourses(one, fresh.map(([each, k]) => [each.courses[name][k], each.spans[k]]));
  }
  const errors = Object.assign({}, contents.errors, ...told.map((one) => one.errors));
  return { ...contents, scenarios, kinds, courses, errors };
}

// Courses are 16-bit integers between the lowest and the highest value, which may change.
function addCourses(old, added) {
  const { points } = old;
  const nothing = 65535;
  let { low, high } = old;
  const had = old.values.some((value) => value !== nothing);
  for (const [course] of added) {
    for (const value of course ?? []) {
      if (value < low || !had) low = Math.min(had ? low : value, value);
      if (value > high || !had) high = Math.max(had ? high : value, value);
    }
  }
  const scale = 65534 / Math.max(high - low, 1e-12);
  const values = new Uint16Array(old.values.length + points * added.length).fill(nothing);
  if (low === old.low && high === old.high) {
    values.set(old.values);
  } else {
    const step = (old.high - old.low) / 65534;
    old.values.forEach((value, k) => {
      if (value !== nothing) values[k] = Math.round((old.low + value * step - low) * scale);
    });
  }
  added.forEach(([course], k) => {
    const at = old.values.length + k * points;
    course?.forEach((value, j) => (values[at + j] = Math.round((value - low) * scale)));
  });
  const begin = old.begin.concat(added.map(([, [one]]) => one));
  const end = old.end.concat(added.map(([, [, one]]) => one));
  return { points, low, high, begin, end, values };
}
