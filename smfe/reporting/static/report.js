"use strict";
(function () {
  const embedded = JSON.parse(document.getElementById("plots").textContent);
  const array = smfeArrays(embedded.arrays);
  function resolve(part) {
    if (Array.isArray(part)) return part.map(resolve);
    if (part === null || typeof part !== "object") return part;
    if ("array" in part) return array(part.array);
    return Object.fromEntries(Object.entries(part).map(([key, value]) => [key, resolve(value)]));
  }
  const plots = resolve(embedded.plots);
  const names = Object.keys(plots);
  const config = {
    displaylogo: false,
    responsive: true,
    modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"],
    toImageButtonOptions: { format: "svg" },
  };
  // plotly's own buttons change all traces or a fixed set alike; a view changes lines and bands differently.
  function switchView(div, event) {
    const view = event.button.args[0];
    Plotly.restyle(div, { y: view.y }, view.lines)
      .then(() => view.fills.length && Plotly.restyle(div, { opacity: view.band ? 1 : 0 }, view.fills))
      .then(() => {
        const changes = Object.assign({}, view.layout);
        for (const key of Object.keys(div.layout)) {
          if (/^yaxis/.test(key) && div.layout[key].title && div.layout[key].title.text) {
            changes[key + ".title.text"] = view.title;
          }
        }
        return Plotly.relayout(div, changes);
      });
  }
  // One after the other, so that the page can be read and scrolled from the first moment.
  function draw(at) {
    if (at === names.length) {
      document.body.dataset.ready = "yes";
      return;
    }
    const div = document.getElementById(names[at]);
    Plotly.newPlot(div, plots[names[at]].data, plots[names[at]].layout, config).then(() => {
      div.on("plotly_buttonclicked", (event) => switchView(div, event));
      setTimeout(draw, 0, at + 1);
    });
  }
  function fit(width) {
    for (const name of names) {
      const div = document.getElementById(name);
      if (div.layout) {
        Plotly.relayout(div, width ? { width: width, autosize: false } : { width: null, autosize: true });
      }
    }
  }
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details:not([data-table])").forEach((d) => {
      d.dataset.was = d.open ? "open" : "";
      d.open = true;
    });
    fit(690);
  });
  window.addEventListener("afterprint", () => {
    document.querySelectorAll("details:not([data-table])").forEach((d) => (d.open = d.dataset.was === "open"));
    fit(0);
  });
  draw(0);
})();
