"use strict";

// Copies a text, and returns a sentence that says whether it was.
async function copyText(text, what) {
  if (text === null) return "There is nothing to copy.";
  try {
    if (!navigator.clipboard) throw new DOMException("This browser gives the page no clipboard.");
    await navigator.clipboard.writeText(text);
  } catch (error) {
    if (!(error instanceof DOMException)) throw error;
    if (!copiedByHand(text)) return `${what} could not be copied: this browser does not let the page.`;
  }
  return `${what} is copied.`;
}

function copiedByHand(text) {
  const field = document.createElement("textarea");
  field.value = text;
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  return done;
}
