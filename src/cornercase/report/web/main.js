"use strict";

// Plotly is compressed in the file and unpacked once, when the first view needs it.
let plotlyLoaded = null;
// Delay in ms after which Plotly is unpacked if no view needed it before.
const UNHURRIED = 6000;

function loadPlotly() {
  plotlyLoaded ??= unpack(document.getElementById("plotly").textContent).then((bytes) => {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(bytes);
    document.head.append(script);
    return window.Plotly;
  });
  return plotlyLoaded;
}

async function begin() {
  const live = isLive();
  const contents = live ? await firstContents() : JSON.parse(document.getElementById("contents").textContent);
  const store = new Store(contents);
  const recordings = live ? new ServedRecordings(store) : new EmbeddedRecordings(contents.recordings);
  setTheme(rememberedTheme());
  showTools(document.getElementById("tools"), store);
  const bar = new FilterBar(document.getElementById("filters"), store);
  const link = new Link(store, bar);
  // The link comes first, so that the replay starts with the selection of the address.
  if (typeof showReplay === "function") showReplay(document.getElementById("replay"), store, recordings);
  foldAnswers(document.getElementById("answers"));
  const views = new Views(document.getElementById("views"), store);
  window.cornercase = { ...window.cornercase, store, recordings, bar, link, views, settled: () => views.settled() };
  window.cornercase.actions = showActions(document.getElementById("replay"), store, recordings);
  if (live) window.cornercase.following = new Following(store, recordings);
  // The page is usable once filters, table and visible views are ready; Plotly follows.
  await views.settled();
  document.documentElement.dataset.ready = "true";
  // Before printing there is no time to wait for Plotly.
  views.makeAll(() => setTimeout(() => whenIdle(() => views.drawAll()), UNHURRIED));
}

begin().catch((error) => {
  document.getElementById("about").textContent = `This page cannot be shown: ${error.message}`;
  throw error;
});
