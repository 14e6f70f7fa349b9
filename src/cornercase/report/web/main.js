"use strict";

// Plotly is in the file as compressed text: it is unpacked once, when the first view needs it.
let plotlyLoaded = null;

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
  const contents = JSON.parse(document.getElementById("contents").textContent);
  const store = new Store(contents);
  const recordings = new EmbeddedRecordings(contents.recordings);
  await loadPlotly();
  showViews(document.getElementById("views"), store);
  window.cornercase = { store, recordings };
  document.documentElement.dataset.ready = "true";
}

begin();
