"use strict";

// Legend of colours and symbols below a drawing.

function legendItem(list, text, draw = null) {
  const item = document.createElement("li");
  if (draw) {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 32;
    const g = canvas.getContext("2d");
    g.scale(2, 2);
    draw(g);
    item.append(canvas);
  }
  item.append(unturned(text));
  list.append(item);
  return item;
}

// `sample` draws the example of a style: a symbol, or a piece of a line.
function fillLegend(list, store, sample = (g, style) => drawSymbol(g, style, 8, 8, 4.5)) {
  const looks = rowLooks(store);
  const { scenarios } = store.contents;
  list.replaceChildren();
  const counts = new Array(looks.styles.length).fill(0);
  const roles = new Map();
  let failed = 0;
  for (let row = 0; row < store.n; row++) {
    if (!store.shown[row]) continue;
    if (scenarios.failed[row]) failed += 1;
    else counts[looks.of[row]] += 1;
    if (scenarios.kept[row]) roles.set(keptRole(store, row), (roles.get(keptRole(store, row)) ?? 0) + 1);
  }
  if (looks.column) addScale(list, store, looks);
  else {
    looks.styles.forEach((style, k) => {
      if (counts[k]) legendItem(list, `${style.name} (${counts[k]})`, (g) => sample(g, style));
    });
  }
  if (sample === legendLine) return;
  const kept = { colour: themeColours().muted, symbol: "circle" };
  for (const [role, count] of roles) {
    const text = role === "kept" ? `kept (${count})` : `kept, ${role} (${count})`;
    legendItem(list, text, (g) => drawKept(g, kept, role, 8, 8.5, 2.7));
  }
  const cross = { colour: themeColours().danger, symbol: "cross" };
  if (failed) legendItem(list, `failed (${failed})`, (g) => drawSymbol(g, cross, 8, 8, 4));
}

function addScale(list, store, looks) {
  const bar = document.createElement("span");
  bar.className = "bar";
  const stops = [0, 0.25, 0.5, 0.75, 1].map((share) => scaleColour(looks.flip ? 1 - share : share));
  bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  const item = legendItem(list, `${store.axis(looks.column).title}: ${formatNumber(looks.low)}`);
  item.append(bar, formatNumber(looks.high));
}

function legendLine(g, { colour, label }) {
  g.strokeStyle = colour;
  g.lineWidth = 2;
  g.setLineDash(label > 0 ? DASHES[label % DASHES.length].map((one) => one / 2) : []);
  line(g, 0, 8, 16, 8);
}
