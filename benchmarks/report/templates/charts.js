// Charts: drawn by the bundled Vega with its expression interpreter, so that the page needs no eval.
const specs = read("charts");
const draw = (place) => {
  place.view?.finalize();
  place.classList.remove("drawn");
  return vegaEmbed(place, specs[place.dataset.spec], {
    ast: true,
    renderer: "svg",
    tooltip: { theme: matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light" },
    actions: false,
  }).then(({ view }) => {
    place.view = view;
    place.classList.add("drawn");
    view.addEventListener("click", (_, item) => {
      const datum = item?.datum;
      if (datum?.label) report.choose(datum.label, datum.scene ?? "");
    });
    return view.signal("chosen", report.label).runAsync();
  }).catch((error) => {
    place.textContent = "The chart could not be drawn: " + error;
    console.error(error);
  });
};
const places = [...document.querySelectorAll(".vega")];
const drawn = places.map(draw);
report.listeners.push((label) => places.forEach((place) => place.view?.signal("chosen", label).runAsync()));

for (const select of document.querySelectorAll("select[data-opening]")) {
  const figure = select.closest("figure"), place = figure.querySelector(".vega");
  select.addEventListener("change", () => {
    place.dataset.spec = select.value;
    figure.querySelectorAll(".words").forEach((words) => { words.hidden = words.dataset.for !== select.value; });
    place.setAttribute("aria-label", figure.querySelector("figcaption").textContent.trim() + ": " + select.selectedOptions[0].textContent);
    report.drawing = draw(place);
  });
}
