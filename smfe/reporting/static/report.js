"use strict";
(function () {
  const stored = JSON.parse(document.getElementById("plots").textContent);
  const array = window.smfeArrays(stored.arrays);
  const NARROW = 620;
  const PAPER = 690;
  const fingers = window.matchMedia("(pointer: coarse)").matches;
  const config = { displayModeBar: false, doubleClick: "reset", showTips: false };

  function resolve(part) {
    if (Array.isArray(part)) return part.map(resolve);
    if (part === null || typeof part !== "object") return part;
    if (typeof part.array === "number") return array(part.array);
    return Object.fromEntries(Object.entries(part).map(([key, value]) => [key, resolve(value)]));
  }
  function element(tag, properties, children) {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...(children || []));
    return made;
  }
  function plain(text) {
    const decoder = element("textarea");
    decoder.innerHTML = text;
    return decoder.value;
  }

  // --- How a figure fits its place: beside narrow margins there is no room for labels at the ends of lines. ---
  function sizes(spec, width) {
    const layout = spec.layout;
    const out = { width: width, height: layout.height, margin: layout.margin, font: layout.font };
    if (spec.entry) out.height = Math.min(layout.height, width < NARROW ? 420 : 600);
    out.annotations = layout.annotations || [];
    if (width >= NARROW) return out;
    out.margin = Object.assign({}, layout.margin, { l: 52, r: 10 });
    out.font = Object.assign({}, layout.font, { size: 11 });
    out.annotations = out.annotations
      .filter((note) => !note.wide)
      .map((note) => (note.ax ? Object.assign({}, note, { ax: 0.4 * note.ax, font: { size: 11 } }) : note));
    return Object.assign(out, spec.narrow || {});
  }
  function fit(div, width) {
    const spec = div.smfe;
    if (!spec || !div._fullLayout) return;
    const changes = sizes(spec, width || div.clientWidth);
    if (width) Object.assign(changes, spec.paper || {});
    changes.annotations = changes.annotations.filter((note) => !spec.hidden.has(note.group));
    if (spec.panels) changes.annotations = smfePanels.notes(spec, changes.annotations);
    return Plotly.relayout(div, changes);
  }
  function draw(div) {
    if (div.smfe) return;
    const spec = resolve(stored.plots[div.id]);
    spec.hidden = new Set();
    div.smfe = spec;
    const layout = Object.assign({}, spec.layout, sizes(spec, div.clientWidth), { showlegend: false });
    // A finger that moves over a figure scrolls the page.
    if (fingers) layout.dragmode = false;
    div.style.minHeight = "";
    // A copy: what is zoomed or moved must not become what the figure began with.
    Plotly.newPlot(div, spec.data, structuredClone(layout), config).then(() => {
      if (!spec.panels) return;
      div.on("plotly_clickannotation", (event) => choose(div, spec.entry ? "" : event.annotation.entry));
      // Nine panels side by side cannot be read on a phone.
      if (div.clientWidth < NARROW && spec.panels.length > 3) choose(div, spec.panels[0].name);
    });
  }

  // --- Switches of a figure: HTML, so that the keyboard reaches them. A toolbar is one stop, arrows move within. ---
  const SVG = "http://www.w3.org/2000/svg";
  const DASHES = { solid: "", dash: "8 4", dot: "2 3", dashdot: "8 3 2 3", longdash: "13 4", longdashdot: "13 3 2 3" };
  const SYMBOLS = {
    circle: "M13 2a4 4 0 1 0 .01 0z",
    "circle-open": "M13 2a4 4 0 1 0 .01 0z",
    x: "M9 2l8 8M17 2l-8 8",
    "triangle-up-open": "M13 2l5 8h-10z",
    "triangle-up": "M13 2l5 8h-10z",
    "triangle-down": "M13 10l5 -8h-10z",
    star: "M13 0l1.6 4.4h4.6l-3.7 2.8 1.4 4.5-3.9-2.7-3.9 2.7 1.4-4.5-3.7-2.8h4.6z",
    square: "M9 2h8v8h-8z",
    diamond: "M13 1l5 5-5 5-5-5z",
  };
  function swatch(trace) {
    const picture = document.createElementNS(SVG, "svg");
    picture.setAttribute("width", "26");
    picture.setAttribute("height", "12");
    picture.setAttribute("aria-hidden", "true");
    const path = document.createElementNS(SVG, "path");
    const markers = (trace.mode || "lines") === "markers";
    const marker = trace.marker || {};
    const line = trace.line || {};
    if (trace.type === "bar" || trace.fill === "toself" || trace.fill === "tozeroy") {
      path.setAttribute("d", "M2 2h22v8h-22z");
      path.setAttribute("fill", marker.color || trace.fillcolor || "#888");
    } else if (markers) {
      const open = /open$|^x$/.test(marker.symbol || "");
      const colour = typeof marker.color === "string" ? marker.color : "#000";
      path.setAttribute("d", SYMBOLS[marker.symbol || "circle"] || SYMBOLS.circle);
      path.setAttribute("fill", open ? "none" : colour);
      path.setAttribute("stroke", (marker.line || {}).color === "#000" ? "#000" : colour);
      path.setAttribute("stroke-width", marker.symbol === "x" ? "3" : "1.5");
    } else {
      path.setAttribute("d", "M0 6H26");
      path.setAttribute("stroke", line.color || "#000");
      path.setAttribute("stroke-width", Math.max(2, line.width || 2));
      path.setAttribute("stroke-dasharray", DASHES[line.dash || "solid"] || "");
    }
    picture.append(path);
    return picture;
  }
  function legend(div, spec) {
    const groups = new Map();
    spec.data.forEach((trace, at) => {
      const key = groupOf(trace, at);
      const group = groups.get(key) || groups.set(key, { lines: [] }).get(key);
      group.lines.push(at);
      if (trace.name && trace.showlegend !== false && !group.trace) group.trace = trace;
    });
    return [...groups].filter(([, group]) => group.trace).map(([key, group]) => {
      const button = element("button", { type: "button", title: "show or hide" }, [swatch(group.trace), plain(group.trace.name)]);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        draw(div);
        const shown = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(shown));
        div.smfe.hidden[shown ? "delete" : "add"](key);
        Plotly.restyle(div, { visible: group.lines.map((at) => visible(div.smfe, at)) }, group.lines).then(() => fit(div));
      });
      return button;
    });
  }
  function groupOf(trace, at) {
    return trace.legendgroup || trace.name || String(at);
  }
  function visible(spec, at) {
    const trace = spec.data[at];
    return !spec.hidden.has(groupOf(trace, at)) && (!spec.panels || smfePanels.shows(spec, trace));
  }
  // Shows one panel of a grid over the whole figure; "" shows all.
  function choose(div, name) {
    draw(div);
    const spec = div.smfe;
    spec.entry = name;
    const select = document.getElementById(div.id + "-entry");
    if (select) select.value = name;
    const every = spec.data.map((trace, at) => at);
    return Plotly.restyle(div, { visible: every.map((at) => visible(spec, at)) }, every)
      .then(() => Plotly.relayout(div, smfePanels.layout(spec)))
      .then(() => fit(div));
  }
  function entries(div, panels) {
    const select = element("select", { id: div.id + "-entry" }, [
      element("option", { value: "", textContent: "all " + panels.length }),
      ...panels.map((panel) => element("option", { value: panel.name, textContent: panel.name })),
    ]);
    select.addEventListener("change", () => choose(div, select.value));
    return element("label", { className: "entry" }, ["Entry ", select]);
  }
  // One stop of the tabulator for all parts of a bar: arrows move within.
  function rove(bar, parts) {
    bar.setAttribute("role", "toolbar");
    parts.forEach((part, at) => (part.tabIndex = at ? -1 : 0));
    bar.addEventListener("keydown", (event) => {
      const at = parts.indexOf(document.activeElement);
      const steps = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };
      let next = steps[event.key] ? (at + steps[event.key] + parts.length) % parts.length : -1;
      if (event.key === "Home") next = 0;
      if (event.key === "End") next = parts.length - 1;
      if (at < 0 || next < 0) return;
      event.preventDefault();
      parts.forEach((part, k) => (part.tabIndex = k === next ? 0 : -1));
      parts[next].focus();
    });
  }
  function toolbar(name, buttons) {
    const bar = element("div", { className: "toolbar" }, buttons);
    bar.setAttribute("aria-label", name);
    rove(bar, buttons);
    return bar;
  }
  function wholeRange(div) {
    draw(div);
    const changes = {};
    for (const [key, axis] of Object.entries(div.layout)) {
      if (!/^[xy]axis/.test(key)) continue;
      const first = div.smfe.ranges && key in div.smfe.ranges ? div.smfe.ranges[key] : (div.smfe.layout[key] || {}).range;
      changes[key + (first ? ".range" : ".autorange")] = first ? first.slice() : true;
    }
    Plotly.relayout(div, changes);
  }
  function save(div) {
    draw(div);
    const layout = Object.assign({}, div.layout, { showlegend: true });
    Plotly.downloadImage({ data: div.data, layout: layout }, { format: "svg", filename: div.id.replace(/^plot-/, ""), width: div.clientWidth, height: div.clientHeight });
  }
  // A view of a figure changes lines and bands differently: bands belong to one view only.
  function show(div, at) {
    draw(div);
    const view = div.smfe.views[at];
    div.smfe.view = at;
    Plotly.restyle(div, { y: view.y }, view.lines)
      .then(() => view.fills.length && Plotly.restyle(div, { opacity: view.band ? 1 : 0 }, view.fills))
      .then(() => {
        const changes = Object.assign({}, view.layout);
        for (const key of Object.keys(div.layout)) {
          if (/^yaxis/.test(key) && div.layout[key].title && div.layout[key].title.text) changes[key + ".title.text"] = view.title;
        }
        if (div.smfe.panels) Object.assign(changes, smfePanels.layout(div.smfe));
        div.smfe.ranges = {};
        for (const key of Object.keys(view.layout)) {
          if (/\.range$/.test(key)) div.smfe.ranges[key.slice(0, -6)] = view.layout[key];
        }
        return Plotly.relayout(div, changes);
      });
  }
  function views(div, found) {
    const labels = found.map((view, at) => {
      const input = element("input", { type: "radio", name: div.id + "-view", checked: at === 0 });
      input.addEventListener("change", () => show(div, at));
      return element("label", {}, [input, view.label]);
    });
    return element("fieldset", { className: "choice" }, [element("legend", { className: "unseen", textContent: "Show" }), ...labels]);
  }
  function prepare(div) {
    if (div.dataset.prepared || !(div.id in stored.plots)) return;
    div.dataset.prepared = "yes";
    const spec = stored.plots[div.id];
    const controls = element("div", { className: "controls" });
    if (spec.views) controls.append(views(div, spec.views));
    if (spec.panels && spec.panels.length > 1) controls.append(entries(div, spec.panels));
    const range = element("button", { type: "button", className: "act", textContent: "Whole range" });
    range.addEventListener("click", () => wholeRange(div));
    const picture = element("button", { type: "button", className: "act", textContent: "Save SVG" });
    picture.addEventListener("click", () => save(div));
    controls.append(toolbar("Lines and tools of this figure", [...legend(div, spec), range, picture]));
    div.before(controls);
    observer.observe(div);
  }

  // --- Figures are drawn when they come near; what is folded is not on the page before it is opened. ---
  function ready() {
    document.body.dataset.ready = "yes";
  }
  const observer = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        observer.unobserve(entry.target);
        draw(entry.target);
      }
      ready();
    },
    { rootMargin: "300px 0px" },
  );
  function prepareAll() {
    const found = document.querySelectorAll(".plot");
    found.forEach(prepare);
    return found.length;
  }
  document.addEventListener(
    "toggle",
    (event) => {
      if (!event.target.open) return;
      event.target.querySelectorAll(":scope > template").forEach((part) => part.replaceWith(part.content));
      prepareAll();
    },
    true,
  );
  document.addEventListener("figures", prepareAll);
  // A choice shows one of several parts of the page: <input type="radio" data-shows="lobes_2">, <div data-part="lobes_2">.
  document.addEventListener("change", (event) => {
    const wanted = event.target.dataset.shows;
    if (wanted === undefined) return;
    const names = new Set([...document.getElementsByName(event.target.name)].map((input) => input.dataset.shows));
    document.querySelectorAll("[data-part]").forEach((part) => {
      if (names.has(part.dataset.part)) part.hidden = part.dataset.part !== wanted;
    });
    document.querySelectorAll(".plot").forEach((div) => div.clientWidth && fit(div));
  });

  const drawn = () => [...document.querySelectorAll(".plot")].filter((div) => div.smfe && div.clientWidth);
  let waiting = 0;
  window.addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => drawn().forEach((div) => fit(div)), 100);
  });
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll(".plot").forEach((div) => {
      if (!div.clientWidth) return;
      draw(div);
      fit(div, PAPER);
    });
  });
  window.addEventListener("afterprint", () => drawn().forEach((div) => fit(div)));
  document.querySelectorAll("nav .links").forEach((bar) => rove(bar, [...bar.children]));
  if (!prepareAll()) ready();
})();
