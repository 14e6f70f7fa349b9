"use strict";

// A film of the replay as WebM: it plays from the beginning to the end at the chosen speed, and is saved then.

// VP8 first: it is encoded while the replay is drawn, and VP9 takes so long that pictures are lost.
const FILM_TYPES = ["video/webm;codecs=vp8", "video/webm"];
const FILM_RATE = 25;
// Below each scene, the time and the score.
const FILM_LINE = 22;

// The form that this browser can record; undefined if it can record none.
function filmType() {
  const can = typeof MediaRecorder === "function" && "captureStream" in HTMLCanvasElement.prototype;
  return can ? FILM_TYPES.find((type) => MediaRecorder.isTypeSupported(type)) : undefined;
}

class ReplayFilm {
  constructor(panel) {
    this.panel = panel;
    this.recorder = null;
    const title = "Play from the beginning, and save it as a film (WebM); a second click ends it";
    this.button = textButton("film", "Film", title, () => (this.recorder ? this.end() : this.begin()));
    this.button.setAttribute("aria-pressed", "false");
    this.button.hidden = filmType() === undefined;
  }

  begin() {
    const { panel } = this;
    this.panes = panel.there();
    if (!this.panes.length) return;
    this.sheet = document.createElement("canvas");
    // Sizes that codecs take are even; the film keeps that of its beginning.
    const even = (size) => 2 * Math.ceil(size / 2);
    this.sheet.width = even(this.panes.reduce((sum, { canvas }) => sum + canvas.width, 0));
    this.ratio = window.devicePixelRatio || 1;
    this.sheet.height = even(Math.max(...this.panes.map(({ canvas }) => canvas.height)) + FILM_LINE * this.ratio);
    this.context = this.sheet.getContext("2d");
    const stream = this.sheet.captureStream(FILM_RATE);
    this.recorder = new MediaRecorder(stream, { mimeType: filmType(), videoBitsPerSecond: 4e6 });
    const parts = [];
    this.recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
    this.recorder.addEventListener("stop", () => {
      for (const track of stream.getTracks()) track.stop();
      saveFilm(new Blob(parts, { type: "video/webm" }), `${this.panes.map(({ id }) => `scenario-${id}`).join("-and-")}.webm`);
      this.recorder = null;
      this.button.setAttribute("aria-pressed", "false");
    });
    this.button.setAttribute("aria-pressed", "true");
    panel.goTo("start");
    panel.draw();
    this.frame();
    this.recorder.start();
    panel.clock.play();
    requestAnimationFrame(() => this.follow());
  }

  end() {
    if (this.recorder?.state === "recording") this.recorder.stop();
    this.panel.clock.pause();
  }

  // A frame after each that the page draws, until the replay has ended, was paused, or shows another scenario.
  follow() {
    if (this.recorder?.state !== "recording") return;
    // No more pictures than the film has.
    if (performance.now() - this.last >= 1000 / FILM_RATE - 4 || !this.panel.clock.playing) this.frame();
    const same = this.panes.every((pane) => pane.recording);
    if (this.panel.clock.playing && same) requestAnimationFrame(() => this.follow());
    // The last frame is seen for a moment.
    else setTimeout(() => this.end(), 400);
  }

  frame() {
    this.last = performance.now();
    const { context, sheet, ratio } = this;
    const { halo, label } = this.panel.colours;
    context.fillStyle = halo;
    context.fillRect(0, 0, sheet.width, sheet.height);
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.fillStyle = label;
    let left = 0;
    for (const { canvas, title, now } of this.panes) {
      context.drawImage(canvas, left, 0);
      const text = `${title.textContent} · ${now.textContent}`;
      context.fillText(text, left + 6 * ratio, sheet.height - 7 * ratio, canvas.width - 12 * ratio);
      left += canvas.width;
    }
  }
}

function saveFilm(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
