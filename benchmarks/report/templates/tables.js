// Tables: sort by a heading; numbers by their full value, cells without a number always last.
const first = (text) => Number(text.replace("−", "-").match(/-?\d+(\.\d+)?(e[+-]?\d+)?/)?.[0] ?? NaN);
for (const table of document.querySelectorAll("table")) {
  const heads = [...(table.tHead?.rows[0].cells ?? [])];
  heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const rows = [...table.tBodies[0].rows];
    const text = (row) => row.cells[column].dataset.key ?? row.cells[column].textContent.trim();
    // A column is one of numbers where every cell begins with one, or with a sign or bracket before it.
    const numeric = rows.every((row) => /^(–|$|(over|under|[<>]|±)?\s*[-−]?[\d.])/.test(text(row)));
    const key = new Map(rows.map((row) => [row, numeric ? first(text(row)) : text(row)]));
    const none = (value) => value === "" || Number.isNaN(value);
    rows.sort((a, b) => {
      const x = key.get(a), y = key.get(b);
      if (none(x) || none(y)) return none(x) - none(y);
      return (up ? 1 : -1) * (numeric ? x - y : x.localeCompare(y));
    });
    table.tBodies[0].append(...rows);
  }));
}

const scores = document.querySelector("table.scores"), filter = document.getElementById("filter");
const sift = () => {
  const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const row of scores.tBodies[0].rows) {
    const text = row.textContent.toLowerCase();
    row.hidden = !words.every((word) => text.includes(word)) || (report.label !== "" && row.dataset.label !== report.label);
  }
};
filter.addEventListener("input", sift);
report.listeners.push(sift);
