"use strict";

// Scores by two metrics, with the Pareto front.
class FrontPlot extends SpacePlot {
  drawBase(g) {
    super.drawBase(g);
    const { store } = this;
    const rows = (store.contents.front ?? []).map((id) => store.rows.get(id)).filter((row) => row !== undefined);
    g.strokeStyle = themeColours().text;
    g.lineWidth = 1.6;
    for (const row of rows) {
      const place = this.placeOf(row);
      if (place === null) continue;
      symbolPath(g, "diamond", ...place, this.radius() + 3.5);
      g.stroke();
    }
  }

  title() {
    return `Pareto front, ${super.title()}`;
  }
}

VIEWS.push({
  name: "front",
  title: "Pareto front",
  about: (store) => `Diamonds: the ${store.contents.front.length} on the front.`,
  more: "Diamonds: no other scenario is as critical in every metric and more critical in one.",
  known: true,
  wanted: (store) => Boolean(store.contents.front?.length) && store.contents.metrics.length > 1,
  create(box, store) {
    const names = store.contents.metrics.map(({ name }) => name);
    const chosen = names.slice(0, 2);
    const options = document.createElement("div");
    options.className = "options";
    box.append(options);
    const plot = new FrontPlot(box, store, () => chosen.map((name) => `score ${name}`));
    const selects = chosen.map((name, k) => {
      const select = labelledSelect(options, k ? "Upwards" : "Across", `front-${k ? "y" : "x"}`);
      setOptions(select, names.map((each) => [each, each]), name);
      select.addEventListener("change", () => {
        chosen[k] = select.value;
        plot.redraw(new Set(["options"]));
      });
      return select;
    });
    options.hidden = selects.length && names.length < 3;
    const legend = document.createElement("ul");
    legend.className = "legend";
    box.append(legend);
    return {
      plot,
      redraw(events) {
        plot.redraw(events);
        if (!onlyMarks(events)) fillLegend(legend, store);
      },
    };
  },
});
