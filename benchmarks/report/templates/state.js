"use strict";
// State of the page: the chosen estimator. Everything that shows it listens to `choose`.
const read = (id) => JSON.parse(document.getElementById(id).textContent);
const report = (window.report = { ready: false, label: "", csv: read("csv"), views: [], listeners: [] });

report.choose = (label, scene = "") => {
  report.label = label;
  for (const listener of report.listeners) listener(label, scene);
};
document.addEventListener("click", (event) => {
  const button = event.target.closest("button.pick, button.chip");
  if (!button) return;
  const again = button.classList.contains("chip") && button.dataset.label === report.label;
  report.choose(again ? "" : button.dataset.label, button.dataset.scene ?? "");
});
