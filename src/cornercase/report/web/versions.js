"use strict";

// The page of a comparison: shows the chosen pair, the old version's scenario beside the new one's.
async function beginVersions() {
  const contents = JSON.parse(document.getElementById("contents").textContent);
  const section = document.getElementById("replay");
  if (section) {
    const store = new Store(contents);
    const buttons = [...document.querySelectorAll("#telling button")];
    const choose = (button) => {
      for (const one of buttons) one.setAttribute("aria-pressed", String(one === button));
      store.select(Number(button.dataset.old));
      store.select(Number(button.dataset.new), "beside");
    };
    for (const button of buttons) button.addEventListener("click", () => choose(button));
    // The verdict also names scenarios; those that can be played here can be chosen there.
    for (const link of document.querySelectorAll("#answer button")) {
      link.addEventListener("click", () => {
        choose(buttons.find((one) => one.dataset.old === link.dataset.old));
        section.scrollIntoView({ block: "start" });
      });
    }
    choose(buttons[0]);
    const recordings = new EmbeddedRecordings(contents.recordings);
    const replay = showReplay(section, store, recordings);
    window.cornercase = { ...window.cornercase, store, recordings };
    await replay.ready;
  }
  document.documentElement.dataset.ready = "true";
}

beginVersions();
