"use strict";

// The page of a replay alone: its scenarios are shown side by side.
async function beginReplay() {
  const contents = JSON.parse(document.getElementById("contents").textContent);
  const store = new Store(contents);
  const [selected, beside] = contents.shown;
  store.select(selected);
  if (beside !== undefined) store.select(beside, "beside");
  const recordings = new EmbeddedRecordings(contents.recordings);
  const replay = showReplay(document.getElementById("replay"), store, recordings);
  window.cornercase = { ...window.cornercase, store, recordings };
  await replay.ready;
  document.documentElement.dataset.ready = "true";
}

beginReplay();
