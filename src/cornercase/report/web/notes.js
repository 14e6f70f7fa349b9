"use strict";

// Notes on scenarios. In a file they are kept by the browser until the page is saved with them; live they go to the study.

const LONGEST_NOTE = 2000;
// The page as it came, to be saved again; only references, as nothing of it has been changed yet.
const PRISTINE = document.documentElement.cloneNode(true);

class NoteKeeper {
  constructor(store) {
    this.store = store;
    this.key = `cornercase notes ${store.contents.rerun?.key ?? store.contents.study}`;
    this.own = isLive() ? {} : this.remembered();
    const found = { ...store.contents.notes };
    for (const [id, { before, text }] of Object.entries(this.own)) {
      // Where the file says something else by now, it was saved or written anew since.
      if ((found[id] ?? "") === before) found[id] = text;
      else delete this.own[id];
    }
    store.setNotes(found);
  }

  remembered() {
    try {
      return JSON.parse(localStorage.getItem(this.key)) ?? {};
    } catch (error) {
      // The browser keeps nothing for this page, or what another program wrote there.
      if (!(error instanceof DOMException || error instanceof SyntaxError)) throw error;
      return {};
    }
  }

  // Resolves to a sentence for the reader, or null where nothing was changed.
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

  // The page as it came, with all notes in it.
  page() {
    const { store } = this;
    const root = PRISTINE.cloneNode(true);
    const notes = Object.fromEntries([...store.notes].map(([id, text]) => [String(id), text]));
    const holder = root.querySelector("#contents");
    const contents = { ...JSON.parse(holder.textContent), notes };
    // In a script nothing is escaped, so what would end it must not be there.
    holder.textContent = JSON.stringify(contents).replace(/[<\u2028\u2029]/g, escaped);
    return `<!DOCTYPE html>\n${root.outerHTML}\n`;
  }
}
