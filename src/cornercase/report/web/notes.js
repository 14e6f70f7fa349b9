"use strict";

// Notes on scenarios. For a file, the browser stores them until the page is saved; live they go to the study.

const LONGEST_NOTE = 2000;
// The original page, to be saved again; only references, as nothing has been changed yet.
const PRISTINE = document.documentElement.cloneNode(true);

class NoteKeeper {
  constructor(store) {
    this.store = store;
    this.key = `cornercase notes ${store.contents.rerun?.key ?? store.contents.study}`;
    this.own = isLive() ? {} : this.remembered();
    const found = { ...store.contents.notes };
    for (const [id, { before, text }] of Object.entries(this.own)) {
      // If the file contains a different note, it was saved or written again since.
      if ((found[id] ?? "") === before) found[id] = text;
      else delete this.own[id];
    }
    store.setNotes(found);
  }

  remembered() {
    try {
      return JSON.parse(localStorage.getItem(this.key)) ?? {};
    } catch (error) {
      // The browser stores nothing for this page, or the stored text belongs to another program.
      if (!(error instanceof DOMException || error instanceof SyntaxError)) throw error;
      return {};
    }
  }

  // Resolves to a sentence for the reader, or null if nothing changed.
  async write(id, given) {
    const text = given.trim();
    if ((this.store.notes.get(id) ?? "") === text) return null;
    if (isLive()) {
      try {
        await ask(`notes/${id}`, "text", ofStudy(this.store), { method: "PUT", body: text });
      } catch (error) {
        if (!(error instanceof ServerError)) throw error;
        return `The note was not saved. ${error.message}`;
      }
      this.store.setNote(id, text);
      return "Saved in the study.";
    }
    this.store.setNote(id, text);
    this.own[id] = { before: this.store.contents.notes?.[id] ?? "", text };
    try {
      localStorage.setItem(this.key, JSON.stringify(this.own));
      return "Kept by this browser; “Save page with notes” makes a file to send.";
    } catch (error) {
      if (!(error instanceof DOMException)) throw error;
      return "Kept until the page is closed; “Save page with notes” makes a file that keeps it.";
    }
  }

  // The original page with all notes.
  page() {
    const { store } = this;
    const root = PRISTINE.cloneNode(true);
    const notes = Object.fromEntries([...store.notes].map(([id, text]) => [String(id), text]));
    const holder = root.querySelector("#contents");
    const contents = { ...JSON.parse(holder.textContent), notes };
    // Nothing is escaped inside a script, so the text must not contain anything that ends it.
    holder.textContent = JSON.stringify(contents).replace(/[<\u2028\u2029]/g, escaped);
    return `<!DOCTYPE html>\n${root.outerHTML}\n`;
  }
}
