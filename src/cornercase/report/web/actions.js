"use strict";

// Actions for the selected scenario: copy, download, note.
class ActionBar {
  constructor(section, store, recordings) {
    Object.assign(this, { store, recordings });
    this.running = new Running(store);
    this.notes = new NoteKeeper(store);
    this.id = null;
    this.box = document.createElement("div");
    this.box.id = "scenario-actions";
    this.makeNote();
    this.makeButtons();
    section.append(this.box);
    for (const event of ["selected", "contents"]) store.on(event, () => this.refresh());
    store.on("notes", () => this.showNote());
    addEventListener("pagehide", () => this.saveNote());
    this.refresh();
  }

  makeNote() {
    const label = document.createElement("label");
    label.htmlFor = "note";
    this.label = label;
    this.note = document.createElement("textarea");
    this.note.id = "note";
    this.note.rows = 2;
    this.note.maxLength = LONGEST_NOTE;
    this.note.addEventListener("input", () => {
      clearTimeout(this.typing);
      this.typing = setTimeout(() => this.saveNote(), 800);
    });
    this.note.addEventListener("change", () => this.saveNote());
    // Letter keys also control the replay.
    this.note.addEventListener("keydown", (event) => event.stopPropagation());
    this.said = document.createElement("p");
    this.said.id = "note-said";
    this.said.className = "faint";
    this.said.setAttribute("role", "status");
    this.box.append(label, this.note, this.said);
  }

  makeButtons() {
    const row = document.createElement("div");
    row.className = "action-buttons";
    const add = (id, text, act) => {
      const button = document.createElement("button");
      button.type = "button";
      button.id = id;
      button.textContent = text;
      button.addEventListener("click", async () => this.say(await act()));
      row.append(button);
      return button;
    };
    const exact = isLive() ? "" : ", rounded";
    this.copyCommand = add("copy-command", "Copy command", () => copyText(this.running.command(this.id), "The command"));
    this.xosc = add("download-xosc", "Scenario (.xosc)", () => this.saveScenario());
    this.csv = add("download-csv", `Recording (CSV${exact})`, () => this.saveRecording());
    const link = add("copy-link", "Copy link", () => copyText(linkTo(this.id), "The link"));
    // In a notebook the page has no address.
    link.hidden = location.protocol === "about:";
    this.save = add("save-page", "Save page with notes", () => this.savePage());
    this.save.hidden = isLive();
    this.command = document.createElement("pre");
    this.command.id = "scenario-command";
    this.command.tabIndex = 0;
    this.command.setAttribute("aria-label", "Command that runs this scenario");
    this.why = document.createElement("p");
    this.why.className = "faint";
    this.box.append(row, this.command, this.why);
  }

  refresh() {
    const { store } = this;
    if (this.id !== null && this.id !== store.selected) this.saveNote();
    const isNew = this.id !== store.selected;
    this.id = store.selected;
    this.box.hidden = this.id === null;
    if (this.id === null) return;
    if (isNew) this.say("");
    this.label.textContent = `Note on scenario ${this.id}`;
    this.showNote(isNew);
    const command = this.running.command(this.id);
    this.command.textContent = command ?? "";
    this.command.hidden = command === null;
    this.copyCommand.disabled = command === null;
    const { why, file_why: fileWhy } = this.running.told ?? {};
    const hasFile = isLive() ? !fileWhy : this.running.told?.file;
    this.xosc.disabled = !hasFile;
    const hasRecording = this.recordings.has(this.id);
    this.csv.disabled = !hasRecording;
    const isFailed = store.contents.scenarios.failed[store.rows.get(this.id)];
    const leftOut = hasRecording || isFailed ? "" : store.contents.recordings_left_out;
    this.why.textContent = [why, hasFile ? "" : fileWhy, leftOut].filter(Boolean).join(" ");
    this.why.hidden = !this.why.textContent;
  }

  // Do not overwrite a note that is being edited.
  showNote(always = false) {
    if (!always && document.activeElement === this.note) return;
    this.note.value = this.store.notes.get(this.id) ?? "";
  }

  async saveNote() {
    clearTimeout(this.typing);
    if (this.id !== null) this.say(await this.notes.write(this.id, this.note.value));
  }

  say(text) {
    if (text !== null) this.said.textContent = text;
  }

  saveScenario() {
    const name = this.running.told?.name ?? "scenario";
    if (isLive()) return saveServed(this.store, `scenarios/${this.id}.xosc`, `${name}-${padded(this.id)}.xosc`);
    saveFile(this.running.file(this.id), `${name}-${padded(this.id)}.xosc`, "application/xml");
    return "Its roads and catalogs have to lie beside it, as those of the scenario that was explored.";
  }

  async saveRecording() {
    const name = `${this.running.told?.name ?? "recording"}-${padded(this.id)}.csv`;
    if (isLive()) return saveServed(this.store, `recordings/${this.id}.csv`, name);
    saveFile(tableOf(await this.recordings.get(this.id)), name, "text/csv");
    return "Rounded to what the page shows; the study holds all digits.";
  }

  async savePage() {
    await this.saveNote();
    saveFile(this.notes.page(), `${this.running.told?.name ?? "report"}-with-notes.html`, "text/html");
    return "The file holds all notes.";
  }
}

function linkTo(id) {
  const text = window.cornercase?.link?.text() || `id=${id}`;
  return `${location.href.split("#")[0]}#${text}`;
}

function saveFile(content, name, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([content], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

async function saveServed(store, path, name) {
  try {
    const content = await ask(path, "blob", ofStudy(store));
    saveFile(content, name, content.type);
    return "";
  } catch (error) {
    if (!(error instanceof ServerError)) throw error;
    return error.message;
  }
}

// For browsers without clipboard access.
function showActions(section, store, recordings) {
  return new ActionBar(section, store, recordings);
}
