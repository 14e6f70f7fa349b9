"use strict";

// What happened when in a scenario, as the page's contents hold it: marks above the courses, and buttons to go there.

const EVENT_KINDS = [
  {
    key: "sees",
    mark: "ring",
    text: (other) => `could see ${other}`,
    about: "In sight from here on, without interruption. Without a field of view or a range; boxes hide what is behind.",
  },
  {
    key: "foresees",
    mark: "diamond",
    text: () => "could see it coming",
    about: "In sight, and less than 5 s from touching: the ego on its path at its speed, the other straight on at its own.",
  },
  {
    key: "slows",
    mark: "open",
    text: () => "reacted",
    about: "Slows down by at least 0.4 m/s², not earlier than 0.5 s before it could see a collision coming.",
  },
  { key: "brakes", mark: "down", text: () => "braked", about: "Brakes with more than 1.3 m/s²: brake lights are on." },
  { key: "contact", mark: "star", text: (other) => `contact with ${other}`, about: "The boxes touch." },
  { key: "closest", mark: "dot", text: (other) => `closest to ${other}`, about: "The smallest gap between the boxes." },
];

// Events of a recording in the order of time; empty if the page holds none.
function eventsOf(store, id, recording) {
  const found = recording?.events ?? store.contents.events?.[id];
  if (!found) return [];
  const other = unturned(shortName(found.other));
  // Most drivers react by braking.
  const isOne = found.slows !== undefined && found.slows === found.brakes;
  const there = EVENT_KINDS.filter(({ key }) => found[key] !== undefined && !(isOne && key === "slows"));
  const events = there.map(({ key, mark, text, about }) => {
    const gap = key === "closest" ? ` (${withSceneUnit(found.gap, "m", 2)})` : "";
    const name = isOne && key === "brakes" ? "reacted and braked" : text(other) + gap;
    return { key, mark, time: found[key], text: name, about };
  });
  return events.sort((one, next) => one.time - next.time);
}

// Who is at fault, and why; empty if unknown.
function faultOf(store, id, recording) {
  const found = recording?.events ?? store.contents.events?.[id];
  if (!found?.fault) return "";
  const text = `${found.fault}: ${found.why}.`;
  return unturned(found.fault.startsWith("fault") ? `F${text.slice(1)}` : text);
}

// A mark of an event; each kind has a shape of its own, so that it does not depend on colours.
function drawEventMark(context, mark, x, y, colour, halo) {
  context.save();
  context.setLineDash([]);
  context.lineWidth = 1.6;
  context.strokeStyle = context.fillStyle = colour;
  context.beginPath();
  if (mark === "ring" || mark === "dot") {
    context.arc(x, y, 4.2, 0, 2 * Math.PI);
  } else if (mark === "star") {
    for (let k = 0; k < 16; k++) {
      const [radius, angle] = [k % 2 ? 3 : 6.5, (k * Math.PI) / 8];
      context.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
    }
  } else {
    const points = mark === "diamond" ? [[0, -5.5], [5, 0], [0, 5.5], [-5, 0]] : [[-5, -4], [5, -4], [0, 5]];
    for (const [dx, dy] of points) context.lineTo(x + dx, y + dy);
  }
  context.closePath();
  context.fillStyle = mark === "ring" || mark === "open" ? halo : colour;
  context.fill();
  context.stroke();
  if (mark === "dot") {
    context.fillStyle = halo;
    context.beginPath();
    context.arc(x, y, 1.6, 0, 2 * Math.PI);
    context.fill();
  }
  context.restore();
}

// Buttons of the events of the shown scenarios, one line for each.
class EventsLine {
  constructor(seek) {
    this.seek = seek;
    this.box = newElement("div", "replay-events");
    this.marks = [];
  }

  // Lines are { slot, name, events, fault }.
  show(lines, colours) {
    this.marks = [];
    const several = lines.length > 1;
    const parts = lines.filter(({ events }) => events.length).map(({ slot, name, events, fault }) => {
      const line = newElement("div", "events-line");
      line.dataset.slot = slot;
      const list = newElement("ol");
      list.setAttribute("aria-label", `Events in ${name}`);
      if (several) line.append(newElement("h4", "", name));
      for (const event of events) {
        const item = newElement("li");
        const button = newElement("button", "event");
        button.type = "button";
        button.dataset.event = event.key;
        button.dataset.time = event.time;
        button.title = event.about;
        const canvas = newElement("canvas");
        this.marks.push({ canvas, slot, mark: event.mark });
        button.append(canvas, `${event.text} `, newElement("span", "event-time", `${event.time.toFixed(2)} s`));
        button.addEventListener("click", () => this.seek(event.time));
        item.append(button);
        list.append(item);
      }
      line.append(list);
      if (fault) line.append(newElement("p", "events-fault", fault));
      return line;
    });
    this.box.replaceChildren(...parts);
    this.box.hidden = !parts.length;
    this.paint(colours);
  }

  paint(colours) {
    if (!colours) return;
    for (const { canvas, slot, mark } of this.marks) {
      const ratio = window.devicePixelRatio || 1;
      canvas.width = canvas.height = Math.round(16 * ratio);
      const context = canvas.getContext("2d");
      context.scale(ratio, ratio);
      drawEventMark(context, mark, 8, 8, mark === "star" ? colours.hit : colours[slot], colours.halo);
    }
  }
}
