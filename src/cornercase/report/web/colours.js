"use strict";

// Colours by Okabe and Ito, which colour-blind readers can distinguish; symbols and dashes carry the same information.
const KIND_COLOURS = {
  light: ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#b8a800"],
  dark: ["#3d95d6", "#f0792b", "#1fbf92", "#dd94bd", "#f2b42e", "#8accf5", "#ffffff", "#f0e442"],
};
const SYMBOLS = ["circle", "square", "triangle", "diamond", "down", "plus", "star", "pentagon"];
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const PLOTLY_DASHES = ["solid", "dash", "dot", "dashdot"];
const PLOTLY_SYMBOLS = ["circle", "square", "diamond", "cross", "circle-open", "square-open", "diamond-open", "x"];

// Viridis at nine points.
const SCALE = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
const STEPS = 48;

function isDark() {
  const { theme } = document.documentElement.dataset;
  return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

// Colours of the style sheet; read again after each change of the theme.
let coloursRead = null;

function themeColours() {
  if (coloursRead === null) {
    const style = getComputedStyle(document.documentElement);
    const names = ["page", "raised", "sunken", "text", "faint", "line", "grid", "accent", "danger", "muted", "ghost"];
    coloursRead = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    coloursRead.font = style.fontFamily || "sans-serif";
  }
  return coloursRead;
}

function forgetColours() {
  coloursRead = null;
}

function kindColour(label) {
  if (label === null || label < 0) return themeColours().muted;
  const colours = KIND_COLOURS[isDark() ? "dark" : "light"];
  return colours[label % colours.length];
}

function kindSymbol(label) {
  return label === null || label < 0 ? "ring" : SYMBOLS[label % SYMBOLS.length];
}

function mixed(first, second, share) {
  const at = (colour, k) => parseInt(colour.slice(1 + 2 * k, 3 + 2 * k), 16);
  const parts = [0, 1, 2].map((k) => Math.round(at(first, k) + share * (at(second, k) - at(first, k))));
  return `rgb(${parts.join(",")})`;
}

// Colour of a value between 0 and 1, where 1 should stand out: dark on light pages, bright on dark ones.
function scaleColour(share) {
  const from = isDark() ? share : 1 - share;
  // Without the palest yellow on white and the darkest violet on black, which are invisible.
  const place = (isDark() ? 0.12 + 0.88 * from : 0.93 * from) * (SCALE.length - 1);
  const k = Math.min(SCALE.length - 2, Math.floor(place));
  return mixed(SCALE[k], SCALE[k + 1], place - k);
}

// Style of each scenario: `of[row]` is an index into `styles`, each { colour, symbol, name }.
function rowLooks(store) {
  const key = [store.options.colour, store.options.aspect, store.options.metric, isDark(), store.version].join("\n");
  if (store.looks?.key !== key) store.looks = { key, ...makeLooks(store) };
  return store.looks;
}

function makeLooks(store) {
  const { colour } = store.options;
  if (colour === "kind") return looksOfKinds(store);
  if (colour === "outcome") return looksOfOutcomes(store);
  if (colour === "critical") {
    const { critical } = store.contents.scenarios;
    const styles = [
      { colour: themeColours().muted, symbol: "circle", name: "not critical" },
      { colour: themeColours().danger, symbol: "triangle", name: "critical" },
    ];
    return { styles, of: Uint8Array.from(critical, (one) => (one ? 1 : 0)) };
  }
  return looksOfNumbers(store, colour === "metric" ? `score ${store.options.metric}` : colour);
}

function looksOfKinds(store) {
  const { labels } = store.contents.kinds[store.options.aspect];
  const there = [...new Set(labels)].sort((one, other) => (one ?? -2) - (other ?? -2));
  const place = new Map(there.map((label, k) => [label, k]));
  const styles = there.map((label) => ({
    label,
    colour: kindColour(label),
    symbol: kindSymbol(label),
    name: store.kindName(label),
  }));
  return { styles, of: Uint16Array.from(labels, (label) => place.get(label)) };
}

function looksOfOutcomes(store) {
  const { outcomes, scenarios } = store.contents;
  const styles = outcomes.map((name, k) => ({ colour: kindColour(k), symbol: kindSymbol(k), name }));
  styles.push({ colour: themeColours().muted, symbol: "ring", name: "unknown" });
  return { styles, of: Uint16Array.from(scenarios.outcome, (one) => one ?? outcomes.length) };
}

function looksOfNumbers(store, column) {
  const values = store.column(column);
  const [low, high] = finiteRange(values);
  const metric = column.startsWith("score ") ? store.metricOf(column.slice(6)) : null;
  const flip = metric !== null && metric.lower_is_critical;
  const styles = Array.from({ length: STEPS }, (_, k) => ({ colour: scaleColour(k / (STEPS - 1)), symbol: "circle" }));
  const of = Uint8Array.from(values, (value) => {
    const share = high > low ? (value - low) / (high - low) : 0.5;
    return Number.isFinite(share) ? Math.round((flip ? 1 - share : share) * (STEPS - 1)) : 0;
  });
  return { styles, of, column, low, high, flip };
}

function finiteRange(values) {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high && value < Infinity) high = value;
  }
  return low > high ? [0, 1] : [low, high];
}
