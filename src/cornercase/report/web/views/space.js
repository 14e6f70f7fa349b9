"use strict";

VIEWS.push({
  name: "space",
  title: "Parameter space",
  about: "Each point is a scenario that was run.",
  wanted: () => true,
  create(box, store) {
    const [first, second] = store.contents.influential.map((k) => `parameter ${store.contents.parameters[k].name}`);
    const draw = () => {
      const [x, y] = [store.column(first), store.column(second ?? `score ${store.options.metric}`)];
      Plotly.react(box, [{ type: "scatter", mode: "markers", x, y }], {
        xaxis: { title: { text: store.axis(first).title } },
      });
    };
    draw();
    return draw;
  },
});
