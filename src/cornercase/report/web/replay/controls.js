"use strict";

// Buttons and keys of the replay.

const REPLAY_SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
// Icons of the buttons, 16 by 16.
const REPLAY_ICONS = {
  start: "M3 3h2v10H3zM13 3v10L6 8z",
  back: "M11 3v10L4 8zM12 3h1.6v10H12z",
  play: "M4 2.5v11L13.5 8z",
  pause: "M4 3h3v10H4zM9 3h3v10H9z",
  step: "M5 3v10l7-5zM2.4 3H4v10H2.4z",
  near:
    "M7.2 1h1.6v3.2H7.2zM7.2 11.8h1.6V15H7.2zM1 7.2h3.2v1.6H1zM11.8 7.2H15v1.6h-3.2z" +
    "M8 5.6a2.4 2.4 0 1 1 0 4.8 2.4 2.4 0 0 1 0-4.8z",
  all: "M2 2h5v1.6H3.6V7H2zM14 2v5h-1.6V3.6H9V2zM2 14V9h1.6v3.4H7V14zM14 14H9v-1.6h3.4V9H14z",
  closer: "M7.2 3h1.6v4.2H13v1.6H8.8V13H7.2V8.8H3V7.2h4.2z",
  wider: "M3 7.2h10v1.6H3z",
};

function replayIcon(name) {
  const space = "http://www.w3.org/2000/svg";
  const picture = document.createElementNS(space, "svg");
  picture.setAttribute("viewBox", "0 0 16 16");
  picture.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(space, "path");
  path.setAttribute("d", REPLAY_ICONS[name]);
  picture.append(path);
  return picture;
}

function replayButton(id, icon, label, act) {
  const button = newElement("button", "replay-icon");
  button.type = "button";
  button.id = id;
  button.title = button.ariaLabel = label;
  button.setAttribute("aria-label", label);
  button.append(replayIcon(icon));
  button.addEventListener("click", act);
  return button;
}

function textButton(id, text, title, act) {
  const button = newElement("button", "", text);
  button.type = "button";
  button.id = id;
  button.title = title;
  button.addEventListener("click", act);
  return button;
}

class ReplayControls {
  constructor(panel) {
    const { clock, camera } = panel;
    this.panel = panel;
    this.play = replayButton("play", "play", "Play (space)", () => clock.toggle());
    this.scrub = newElement("input");
    Object.assign(this.scrub, { type: "range", id: "scrub", min: 0, max: 1, step: "any", value: 0 });
    this.scrub.setAttribute("aria-label", "Time in s");
    this.scrub.addEventListener("input", () => {
      clock.pause();
      clock.seek(Number(this.scrub.value));
    });
    this.clockText = newElement("output", "replay-time");
    this.clockText.htmlFor = "scrub";
    this.speed = newElement("select");
    this.speed.id = "speed";
    this.speed.setAttribute("aria-label", "Speed of the replay");
    for (const speed of REPLAY_SPEEDS) this.speed.append(new Option(`${speed}×`, speed, speed === 1, speed === 1));
    this.speed.addEventListener("change", () => (clock.speed = Number(this.speed.value)));
    this.follow = textButton("follow", "Follow", "Keep the ego in the middle (F)", () => panel.toggleFollow());
    const sight = "Show whether the ego can see the other, and what hides it (V)";
    this.sight = textButton("sight", "Sight", sight, () => panel.toggleSight());
    this.neighbour = textButton("neighbour", "Neighbour", "", () => panel.toggleNeighbour());
    const expected = "Show the run that the suite was made from, or an earlier one, beside this run (E)";
    this.expected = textButton("expected", "Expected", expected, () => panel.toggleExpected());
    this.expected.hidden = !Object.keys(panel.store.contents.expected?.runs ?? {}).length;
    this.film = new ReplayFilm(panel);
    const time = newElement("div", "replay-row");
    time.append(
      replayButton("to-start", "start", "To the start (Home)", () => panel.goTo("start")),
      replayButton("step-back", "back", "One instant back (left arrow)", () => clock.step(-1)),
      this.play,
      replayButton("step", "step", "One instant on (right arrow)", () => clock.step(1)),
      replayButton("to-critical", "near", "To the most critical instant (C)", () => panel.goTo("critical")),
      this.scrub,
      this.clockText,
    );
    const look = newElement("div", "replay-row");
    look.append(
      this.speed,
      this.follow,
      replayButton("fit", "all", "Show all that moves (0)", () => panel.fit("all")),
      replayButton("zoom-in", "closer", "Closer (+)", () => camera.zoom(1.4)),
      replayButton("zoom-out", "wider", "Wider (-)", () => camera.zoom(1 / 1.4)),
      this.sight,
      this.expected,
      this.neighbour,
      this.film.button,
    );
    this.box = newElement("div", "replay-controls");
    this.box.append(time, look);
  }

  update() {
    const { clock, camera, sight, store } = this.panel;
    const label = clock.playing ? "Pause (space)" : "Play (space)";
    if (this.play.title !== label) {
      this.play.title = label;
      this.play.setAttribute("aria-label", label);
      this.play.replaceChildren(replayIcon(clock.playing ? "pause" : "play"));
    }
    Object.assign(this.scrub, { min: clock.begin, max: clock.end, value: clock.time });
    this.scrub.setAttribute("aria-valuetext", `${clock.time.toFixed(2)} s of ${clock.end.toFixed(2)} s`);
    this.clockText.textContent = `${clock.time.toFixed(2)} s`;
    this.follow.setAttribute("aria-pressed", String(camera.follows));
    this.sight.setAttribute("aria-pressed", String(sight));
    this.expected.setAttribute("aria-pressed", String(store.beside === null && this.panel.expectedRun() !== null));
    this.neighbour.setAttribute("aria-pressed", String(store.beside !== null));
    const compare = "Compare with the nearest scenario that ended otherwise (N)";
    const same = store.contents.called ? null : sameVerdict(store);
    // Where all passed, or all failed, there is no neighbour across that border.
    this.neighbour.disabled = same !== null && store.beside === null;
    this.neighbour.textContent = same === null ? "Neighbour" : `Neighbour: all ${same}`;
    this.neighbour.title =
      store.beside !== null
        ? "Show one scenario only (N)"
        : same === null
          ? compare
          : `The verdict on all scenarios is ${same}, so none has another one`;
  }
}

// Keys of the whole panel; typing into a field is not affected.
function listenToKeys(section, panel) {
  const { clock, camera } = panel;
  const pan = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  const acts = {
    " ": () => clock.toggle(),
    ArrowLeft: () => clock.step(-1),
    ArrowRight: () => clock.step(1),
    Home: () => panel.goTo("start"),
    End: () => panel.goTo("end"),
    "+": () => camera.zoom(1.4),
    "=": () => camera.zoom(1.4),
    "-": () => camera.zoom(1 / 1.4),
    0: () => panel.fit("all"),
    c: () => panel.goTo("critical"),
    f: () => panel.toggleFollow(),
    v: () => panel.toggleSight(),
    n: () => panel.toggleNeighbour(),
    e: () => panel.toggleExpected(),
  };
  section.addEventListener("keydown", (event) => {
    const { target, key } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || panel.empty()) return;
    if (target.matches("input:not([type=range]), select, textarea, a") || target.isContentEditable) return;
    if (target.matches("button, summary") && (key === " " || key === "Enter")) return;
    const act = event.shiftKey && key in pan ? () => camera.pan(...pan[key]) : acts[key] ?? acts[key.toLowerCase()];
    if (!act) return;
    event.preventDefault();
    act();
  });
}
