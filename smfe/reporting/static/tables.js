"use strict";
// Long tables are made when they are opened.
(function () {
  const source = document.getElementById("tables");
  if (!source) return;
  let tables = null;
  function cell(row, kind, text, numeric) {
    const made = document.createElement(kind);
    made.textContent = text;
    if (numeric) made.className = "num";
    row.appendChild(made);
    return made;
  }
  function fill(details) {
    tables = tables || JSON.parse(source.textContent);
    const content = tables[details.dataset.table];
    const table = document.createElement("table");
    const head = table.createTHead().insertRow();
    content.head.forEach((text, k) => (cell(head, "th", text, content.numeric[k]).scope = "col"));
    const body = table.createTBody();
    content.rows.forEach((cells, at) => {
      const row = body.insertRow();
      if (content.css[at]) row.className = content.css[at];
      cells.forEach((text, k) => {
        const made = cell(row, "td", text, content.numeric[k]);
        if (!content.numeric[k] && text.length < 24) made.className = "short";
      });
    });
    const scroll = document.createElement("div");
    scroll.className = "scroll";
    scroll.appendChild(table);
    details.appendChild(scroll);
  }
  document.addEventListener(
    "toggle",
    ({ target }) => target.open && "table" in target.dataset && target.children.length === 1 && fill(target),
    true,
  );
})();
