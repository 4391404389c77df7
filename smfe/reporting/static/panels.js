"use strict";
// One panel of a grid alone: a choice beside the figure, or a click on the name in the corner of the panel.
window.smfePanels = {
  // Layout of the axes: all of them in their places, or one over the whole figure.
  layout(spec) {
    const changes = {};
    const title = spec.views ? spec.views[spec.view || 0].title : "";
    for (const panel of spec.panels) {
      const tail = panel.at === 1 ? "" : String(panel.at);
      const alone = spec.entry === panel.name;
      for (const [axis, text] of [["xaxis", "frequency [Hz]"], ["yaxis", title]]) {
        const own = spec.layout[axis + tail];
        changes[axis + tail + ".visible"] = !spec.entry || alone;
        changes[axis + tail + ".domain"] = alone ? [0, 1] : spec.entry ? [0, 0.001] : own.domain;
        changes[axis + tail + ".showticklabels"] = alone || own.showticklabels;
        changes[axis + tail + ".title.text"] = alone || own.title.text ? text : "";
      }
    }
    return changes;
  },
  // Whether a trace is on what is shown.
  shows(spec, trace) {
    if (!spec.entry) return true;
    const panel = spec.panels.find((one) => one.name === spec.entry);
    return (trace.xaxis || "x") === panel.axes.xaxis;
  },
  // Names in the corners of what is shown.
  notes(spec, notes) {
    if (!spec.entry) return notes;
    return notes.filter((note) => note.entry === spec.entry).map((note) => Object.assign({}, note, { x: 1, y: 1 }));
  },
};
