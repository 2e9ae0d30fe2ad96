"use strict";
// Reads a p-box at the cursor: by mouse or finger on the drawing, by keyboard on the slider below it.
// The page says all of it in its tables as well, so that nothing is lost where no script runs.
for (const figure of document.querySelectorAll("figure")) {
  const store = figure.querySelector('script[type="application/json"]');
  if (store) readOut(figure, figure.querySelector("svg"), JSON.parse(store.textContent));
}

// What the contents name is opened, and paper shows everything.
for (const link of document.querySelectorAll('nav a[href^="#"]'))
  link.addEventListener("click", () => { const part = document.getElementById(link.hash.slice(1)); if (part?.tagName === "DETAILS") part.open = true; });
addEventListener("beforeprint", () => { for (const part of document.querySelectorAll("details")) part.open = true; });

function readOut(figure, svg, data) {
  const [left, top, width, height] = svg.dataset.plot.split(",").map(Number);
  const [low, high] = svg.dataset.x.split(",").map(Number);
  const cursor = svg.appendChild(document.createElementNS(svg.namespaceURI, "path"));
  cursor.setAttribute("class", "line zero");

  const reader = document.createElement("div");
  reader.className = "reader";
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: low, max: high, step: (high - low) / 200, value: data.boxes[0].middle });
  const label = reader.appendChild(document.createElement("label"));
  label.append("read at", slider);
  slider.setAttribute("aria-label", "read the figure at: " + data.quantity);
  const output = reader.appendChild(document.createElement("output"));
  figure.insertBefore(reader, figure.querySelector("figcaption"));

  const percent = (p) => (100 * p).toFixed(p >= 0.0005 && p < 0.0995 ? 1 : 0) + " %";
  function show() {
    const at = Number(slider.value);
    const u = left + (width * (at - low)) / (high - low);
    cursor.setAttribute("d", `M${u} ${top}v${height}`);
    for (const curve of svg.querySelectorAll(".picked")) curve.classList.remove("picked");
    const lines = data.boxes.map((box) => {
      let k = -1;
      while (k + 1 < box.value.length && box.value[k + 1] <= at) k += 1;
      const name = box.name ? box.name + ": " : "";
      if (k < 0) return `${name}below every value flown.`;
      // Steps hold until the next value, curves go on between two.
      const next = box.smooth && k + 1 < box.value.length ? k + 1 : k;
      const part = next > k ? (at - box.value[k]) / (box.value[next] - box.value[k]) : 0;
      const side = (values) => percent(values[k] + part * (values[next] - values[k]));
      const who = (places) => box.corners.length ? ` (${box.corners[places[k]]})` : "";
      if (box.corners.length) for (const corner of [box.at_least[k], box.at_most[k]])
        for (const curve of svg.querySelectorAll(`[data-corner="${box.tag}${corner}"]`)) curve.classList.add("picked");
      // A band from 0 to 100 % excludes nothing.
      const band = [side(box.band_lower), side(box.band_upper)];
      const sampled = band[0] === "0 %" && band[1] === "100 %" ? "" : `; band ${band[0]} to ${band[1]}`;
      const ends = [side(box.lower) + who(box.at_least), side(box.upper) + who(box.at_most)];
      return `${name}${ends[0] === ends[1] ? ends[0] : ends.join(" to ")} of the flights${sampled}.`;
    });
    lines[0] = `At most ${at.toPrecision(3)} ${data.unit}: ${lines[0]}`;
    output.replaceChildren(...lines.map((line) => Object.assign(document.createElement("div"), { textContent: line })));
    slider.setAttribute("aria-valuetext", lines.join(" "));
  }
  function point(event) {
    const box = svg.getBoundingClientRect();
    const u = ((event.clientX - box.left) / box.width) * svg.viewBox.baseVal.width;
    slider.value = low + ((high - low) * (u - left)) / width;
    show();
  }
  svg.addEventListener("pointermove", point);
  svg.addEventListener("pointerdown", point);
  slider.addEventListener("input", show);
  show();
}
