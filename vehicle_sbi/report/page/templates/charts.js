"use strict";
// Charts take their colours from the style sheet, and follow keys and buttons. Their models are Bokeh's.
(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const models = () => Bokeh.documents.flatMap((one) => [...one.all_models]);
  const set = (model, values) => model.setv(Object.fromEntries(Object.entries(values).filter(([key]) => key in model.properties)));

  function paint(parts) {
    const [ink, quiet, grid] = ["ink", "quiet", "grid"].map(colour);
    for (const model of parts) {
      set(model, {
        background_fill_color: null, border_fill_color: null, outline_line_color: null, grid_line_color: grid,
        axis_line_color: quiet, major_tick_line_color: quiet, axis_label_text_color: ink, major_label_text_color: quiet,
        ...(model.type === "Title" ? { text_color: ink } : {}),
      });
      const own = model.tags.length ? colour(String(model.tags[0])) : "";
      if (own) set(model, { line_color: own, fill_color: own, text_color: quiet });
      if (model.name === "place") set(model, { fill_alpha: 0.22, line_color: null });
    }
  }

  function toggle(button, parts) {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    for (const model of parts) if (model.name === button.dataset.curve && "visible" in model.properties) model.visible = on;
  }

  // Zoom by a factor about the middle, and move by a share of what is seen, within the bounds.
  function move(range, factor, share) {
    const [low, high] = range.bounds, width = range.end - range.start;
    const half = Math.min((width * factor) / 2, (high - low) / 2);
    const middle = Math.min(Math.max(range.start + width * (0.5 + share), low + half), high - half);
    range.setv({ start: middle - half, end: middle + half });
  }

  const KEYS = { "+": [0.5, 0], "=": [0.5, 0], "-": [2, 0], ArrowLeft: [1, -0.2], ArrowRight: [1, 0.2] };

  function steer(event, parts, whole) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const range = parts.find((model) => "x_range" in model.properties).x_range;
    if (event.key === "0") range.setv(whole);
    else if (event.key in KEYS) move(range, ...KEYS[event.key]);
    else return;
    event.preventDefault();
  }

  function equip(figure, parts) {
    const { start, end } = parts.find((model) => "x_range" in model.properties).x_range;
    for (const button of figure.querySelectorAll("button.key")) button.addEventListener("click", () => toggle(button, parts));
    figure.querySelector(".chart").addEventListener("keydown", (event) => steer(event, parts, { start, end }));
    // Fingers turn the page: they zoom once a tool is chosen, or by pinching.
    if (matchMedia("(pointer: coarse)").matches)
      for (const model of parts) if (model.type.endsWith("Toolbar")) model.active_drag = null;
  }

  // Each chart is a document; one that is folded away is drawn once it is opened.
  function begin(figure) {
    const id = figure.querySelector(".chart").dataset.chart;
    draw[id]();
    (function wait() {
      const own = Bokeh.documents.find((one) => one.roots().some((root) => root.id === id));
      if (!own) return void setTimeout(wait, 5);
      const parts = [...own.all_models];
      paint(parts);
      equip(figure, parts);
      document.documentElement.dataset.drawn = "true";
    })();
  }

  for (const figure of document.querySelectorAll(".curves")) {
    const folded = figure.closest("details:not([open])");
    if (folded) folded.addEventListener("toggle", () => begin(figure), { once: true });
    else begin(figure);
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paint(models()));
})();
