// What a choice shows: the pressed button, the pictures of the estimator, and a panel of its scenes below the first charts.
const focus = document.getElementById("focus");
const element = (name, text = "", kind = "") => {
  const made = document.createElement(name);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
};
const headings = scores ? [...scores.tHead.rows[0].cells].map((head) => head.textContent.trim()) : [];
const SHOWN = headings.filter((name) => /^(Condition|Stress|RMSE|Coverage|Failed|CPU)/.test(name) && !/valid/.test(name));

const card = (label, scene, rows) => {
  const made = element("article");
  made.dataset.scene = scene;
  made.append(element("h4", scene));
  const scroll = element("div", "", "scroll"), table = element("table"), head = table.createTHead().insertRow();
  scroll.tabIndex = 0;
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", `Scores of ${label} on ${scene}`);
  for (const name of SHOWN) {
    const cell = element("th", name);
    cell.scope = "col";
    head.append(cell);
  }
  const body = table.createTBody();
  for (const row of rows) {
    const line = body.insertRow();
    for (const name of SHOWN) line.append(element("td", row.cells[headings.indexOf(name)].textContent));
    const mixed = row.cells[headings.indexOf("Scene")].querySelector("small"); // elements of another kind
    if (mixed) line.cells[SHOWN.indexOf("Stress")].append(", " + mixed.textContent);
  }
  scroll.append(table);
  made.append(scroll);
  for (const article of document.querySelectorAll("#pictures article")) {
    const figure = [...article.querySelectorAll("figure[data-label]")].find((f) => f.dataset.label === label && f.dataset.scene === scene);
    if (!figure) continue;
    const pictures = element("div", "", "pictures"), bars = article.querySelector(".one");
    pictures.append(bars.cloneNode(true), figure.cloneNode(true));
    made.append(pictures);
  }
  return made;
};

report.listeners.push((label, scene) => {
  for (const button of document.querySelectorAll("button.chip")) button.setAttribute("aria-pressed", String(button.dataset.label === label));
  for (const figure of document.querySelectorAll("#pictures figure[data-label]")) figure.hidden = label !== "" && figure.dataset.label !== label;
  focus.hidden = label === "";
  focus.replaceChildren();
  if (label === "") return;
  const rows = [...scores.tBodies[0].rows].filter((row) => row.dataset.label === label);
  const scenes = [...new Set(rows.map((row) => row.dataset.scene))];
  scenes.sort((a, b) => (b === scene) - (a === scene));
  const close = element("button", "show all", "chip");
  close.type = "button";
  close.dataset.label = "";
  const head = element("h3", label + " ");
  head.append(close);
  focus.append(head, ...scenes.map((name) => card(label, name, rows.filter((row) => row.dataset.scene === name))));
  if (scene) focus.scrollIntoView({ block: "nearest" });
});

Promise.all(drawn).then(() => { report.ready = true; });
