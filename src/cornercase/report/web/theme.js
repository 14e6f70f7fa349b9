"use strict";

const THEMES = ["system", "light", "dark"];

// Stored if the browser allows it.
function rememberedTheme() {
  try {
    const theme = localStorage.getItem("cornercase theme");
    return THEMES.includes(theme) ? theme : "system";
  } catch (error) {
    if (!(error instanceof DOMException)) throw error;
    return "system";
  }
}

function setTheme(theme, store) {
  if (theme === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  try {
    localStorage.setItem("cornercase theme", theme);
  } catch (error) {
    // If nothing is stored, the next page starts with the system's theme.
    if (!(error instanceof DOMException)) throw error;
  }
  forgetColours();
  store?.tell("theme");
}

function showTools(box, store) {
  const button = document.createElement("button");
  button.type = "button";
  button.id = "theme";
  const name = () => {
    button.textContent = { system: "◐ System", light: "☀ Light", dark: "☾ Dark" }[rememberedTheme()];
    button.setAttribute("aria-label", `Colours: ${rememberedTheme()}. Change`);
  };
  let now = rememberedTheme();
  button.addEventListener("click", () => {
    now = THEMES[(THEMES.indexOf(now) + 1) % THEMES.length];
    setTheme(now, store);
    name();
  });
  name();
  const print = document.createElement("button");
  print.type = "button";
  print.id = "print";
  print.textContent = "Print";
  print.addEventListener("click", async () => {
    // A browser does not wait once it prints: charts that were not visible yet are drawn first.
    window.cornercase.views.drawAll();
    if (document.getElementById("plotly")) await loadPlotly();
    setTimeout(() => window.print(), 500);
  });
  box.append(button, print);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    forgetColours();
    store.tell("theme");
  });
  // Paper is white.
  let before = null;
  addEventListener("beforeprint", () => {
    before = document.documentElement.dataset.theme ?? null;
    document.documentElement.dataset.theme = "light";
    document.querySelectorAll("#details details").forEach((each) => (each.open = true));
    forgetColours();
    store.tell("theme");
  });
  addEventListener("afterprint", () => {
    if (before === null) delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = before;
    forgetColours();
    store.tell("theme");
  });
}
