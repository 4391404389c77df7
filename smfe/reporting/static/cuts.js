"use strict";
// A row of the table of cutting tests opens its spectrum below it. All rows are one stop of the keyboard.
(function () {
  const buttons = [...document.querySelectorAll("table.cuts button.opens")];
  function toggle(button) {
    const row = button.closest("tr");
    const open = button.getAttribute("aria-expanded") === "true";
    button.setAttribute("aria-expanded", String(!open));
    if (open) {
      row.nextElementSibling.querySelectorAll(".plot").forEach((div) => Plotly.purge(div));
      row.nextElementSibling.remove();
    } else {
      row.after(document.getElementById(button.dataset.opens).content.cloneNode(true));
      document.dispatchEvent(new Event("figures"));
    }
  }
  function stop(at) {
    buttons.forEach((button, k) => (button.tabIndex = k === at ? 0 : -1));
  }
  buttons.forEach((button, at) => {
    button.closest("tr").addEventListener("click", (event) => {
      if (event.target !== button && String(window.getSelection())) return;
      stop(at);
      toggle(button);
    });
    button.addEventListener("keydown", (event) => {
      const last = buttons.length - 1;
      const next = { ArrowDown: Math.min(at + 1, last), ArrowUp: Math.max(at - 1, 0), Home: 0, End: last }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      stop(next);
      buttons[next].focus();
    });
  });
  stop(0);
})();
