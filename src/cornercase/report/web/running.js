"use strict";

// How to run a scenario again: its command, its file, and its recording as a table.

// A number as Python writes it.
function numberText(value) {
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return String(Object.is(value, -0) ? 0 : value);
  const [digits, exponent] = value.toExponential().split("e");
  const power = Number(exponent);
  if (power < -4 || power >= 16) {
    const size = String(Math.abs(power)).padStart(2, "0");
    return `${digits}e${power < 0 ? "-" : "+"}${size}`;
  }
  const sign = value < 0 ? "-" : "";
  const plain = digits.replace("-", "").replace(".", "");
  if (power < 0) return `${sign}0.${"0".repeat(-power - 1)}${plain}`;
  const whole = plain.slice(0, power + 1).padEnd(power + 1, "0");
  return `${sign}${whole}.${plain.slice(power + 1) || "0"}`;
}

// A word quoted for a Unix shell or PowerShell.
function shellWord(word, windows = navigator.userAgent.includes("Windows")) {
  if (/^[A-Za-z0-9_@%+=:,./-]+$/.test(word) && !(windows && /[@%,]/.test(word))) return word;
  return windows ? `'${word.replaceAll("'", "''")}'` : `'${word.replaceAll("'", `'"'"'`)}'`;
}

class Running {
  constructor(store) {
    this.store = store;
  }

  get told() {
    return this.store.contents.rerun ?? null;
  }

  values(id) {
    const row = this.store.rows.get(id);
    return this.store.contents.scenarios.values.map((column) => column[row]);
  }

  // The words of the command that runs a scenario; null if there is none.
  words(id) {
    const command = this.told?.command;
    if (!command) return null;
    const { parameters } = this.store.contents;
    const sets = this.values(id).flatMap((value, k) => {
      const { name, choices, value_sets: together } = parameters[k];
      const assigned = together?.[value] ?? [[name, choices.length ? choices[value] : numberText(value)]];
      return assigned.flatMap(([one, text]) => ["--set", `${one}=${text}`]);
    });
    const file = command.files.slice(id - 1, id);
    return [...command.before, ...file, ...sets, ...command.after, "-o", `${this.told.name}-${padded(id)}.csv`];
  }

  command(id) {
    const words = this.words(id);
    // Other characters could be control sequences for a terminal, even inside quotes.
    if (words === null || words.some((word) => /[\u0000-\u001f\u007f-\u009f]/.test(word))) return null;
    return words.map((word) => shellWord(word)).join(" ");
  }

  // The scenario file as `cornercase reduce` writes it; null if the page does not contain it.
  file(id) {
    const file = this.told?.file;
    if (!file) return null;
    const { parameters } = this.store.contents;
    // A choice that sets several scenario parameters is the value of each of them.
    const values = this.values(id).flatMap((value, k) => (parameters[k].value_sets?.[0] ?? [null]).map(() => value));
    const filled = (slot) => {
      if (slot === null) return file.kept[id] ?? file.description.join(id);
      if (file.choices[slot].length) return file.choices[slot][values[slot]];
      if (file.kinds[slot] === "boolean") return values[slot] ? "true" : "false";
      if (file.kinds[slot] === "option" && Number.isInteger(values[slot])) return values[slot].toFixed(1);
      return numberText(file.whole.includes(file.kinds[slot]) ? Math.round(values[slot]) : values[slot]);
    };
    return file.pieces[0] + file.slots.map((slot, k) => filled(slot) + file.pieces[k + 1]).join("");
  }
}

function padded(id) {
  return String(id).padStart(5, "0");
}

const CSV_COLUMNS = ["x", "y", "heading", "speed", "acceleration"];
const CSV_BOX = ["length", "width", "center_x"];

// The recording of the page, with numbers rounded to drawing precision.
function tableOf(recording) {
  const digits = Object.fromEntries(recording.fields.map(([name, , step]) => [name, Math.round(-Math.log10(step))]));
  const number = (value, name) => (Number.isNaN(value) ? "nan" : String(Number(value.toFixed(digits[name]))));
  const lines = [["time", "entity", "kind", ...CSV_COLUMNS, ...CSV_BOX, "collision"].join(",")];
  const touched = touchedAt(recording);
  recording.time.forEach((time, t) => {
    recording.names.forEach((name, a) => {
      const motion = CSV_COLUMNS.map((column) => number(recording[column][a][t], column));
      const box = CSV_BOX.map((column) => String(recording[column][a]));
      const others = (touched.get(`${t} ${a}`) ?? []).join(";");
      const texts = [name, recording.kinds[a]].map(csvCell);
      lines.push([number(time, "time"), ...texts, ...motion, ...box, csvCell(others)].join(","));
    });
  });
  return `${lines.join("\n")}\n`;
}

// A collision is written in the row of its first entity, at the nearest instant.
function touchedAt({ collisions, names, time }) {
  const found = new Map();
  for (const [when, a, b] of collisions) {
    let t = 0;
    time.forEach((one, k) => {
      if (Math.abs(one - when) < Math.abs(time[t] - when)) t = k;
    });
    const key = `${t} ${a}`;
    found.set(key, [...(found.get(key) ?? []), names[b]]);
  }
  return found;
}

// A text that a spreadsheet would run as a formula gets an apostrophe, which cornercase's reader removes.
function csvCell(text) {
  const isNumber = /^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?$/.test(text);
  const plain = /^'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]/.test(text) && !isNumber ? `'${text}` : text;
  return /[",\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}
