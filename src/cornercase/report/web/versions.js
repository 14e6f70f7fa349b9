"use strict";

// The page of a comparison: shows the chosen pair, the old version's scenario beside the new one's.
async function beginVersions() {
  const contents = JSON.parse(document.getElementById("contents").textContent);
  const section = document.getElementById("replay");
  if (section) {
    const store = new Store(contents);
    const buttons = [...document.querySelectorAll("#telling button")];
    const difference = document.getElementById("difference");
    let panel = null;
    const choose = async (old) => {
      for (const button of buttons) button.setAttribute("aria-pressed", String(Number(button.dataset.old) === old));
      for (const link of document.querySelectorAll("a.pair-link")) {
        if (Number(link.dataset.old) === old) link.setAttribute("aria-current", "true");
        else link.removeAttribute("aria-current");
      }
      difference.textContent = contents.differences[old]?.text ?? "";
      store.select(old);
      store.select(old + 1, "beside");
      await panel?.follow(() => true);
      showDifference(panel, contents.differences[old]);
    };
    for (const button of buttons) button.addEventListener("click", () => choose(Number(button.dataset.old)));
    // Wherever the page names a scenario that it can play, it is played there, in links as well as in charts.
    document.querySelector("main").addEventListener("click", (event) => {
      const named = event.target.closest("a.pair-link, circle[data-old]");
      if (!named) return;
      choose(Number(named.dataset.old));
      document.getElementById("telling").scrollIntoView({ block: "start" });
    });
    const linked = () => {
      const link = document.querySelector(`a.pair-link[href="#${CSS.escape(location.hash.slice(1))}"]`);
      return link ? Number(link.dataset.old) : null;
    };
    addEventListener("hashchange", () => {
      const old = linked();
      if (old !== null && old !== store.selected) choose(old);
    });
    const first = linked() ?? 1;
    choose(first);
    const recordings = new EmbeddedRecordings(contents.recordings);
    const replay = showReplay(section, store, recordings);
    panel = replay.panel;
    window.cornercase = { ...window.cornercase, store, recordings };
    await replay.ready;
    showDifference(panel, contents.differences[first]);
  }
  document.documentElement.dataset.ready = "true";
}

// To the instant that shows how the two runs differ: a collision of one, else the most critical one of the worse run.
function showDifference(panel, difference) {
  if (!panel || !difference) return;
  const pane = panel.panes[difference.side ? "beside" : "selected"];
  const time = difference.time ?? (pane.recording ? pane.criticalTime() : null);
  if (time === null) return;
  panel.clock.pause();
  panel.clock.seek(time);
}

beginVersions();
