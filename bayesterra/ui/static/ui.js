// What the page does beside htmx: figures beside sliders, arguments of the chosen form, files that are too large.
"use strict";
document.addEventListener("input", event => {
  const slider = event.target;
  if (slider.type === "range") {
    slider.nextElementSibling.value = `${Number(Number(slider.value).toPrecision(3))} ${slider.dataset.unit}`;
  }
});
document.addEventListener("change", event => {
  const { dataset, value, files } = event.target;
  if (dataset.arguments) {
    for (const part of event.target.parentElement.querySelectorAll("[data-of]")) {
      part.hidden = !part.dataset.of.split(" ").includes(value);
    }
  }
  if (dataset.most && files) {
    const large = [...files].some(file => file.size > dataset.most * 2 ** 20);
    event.target.setCustomValidity(large ? `The file is larger than ${dataset.most} MB.` : "");
    event.target.reportValidity();
  }
});
// Buttons that change the form itself load the page anew; the rest goes through htmx.
document.addEventListener("click", event => {
  if (event.target.matches("[data-whole]")) {
    event.preventDefault();
    const { form, name, value } = event.target;
    const hidden = Object.assign(document.createElement("input"), { type: "hidden", name, value });
    form.append(hidden);
    HTMLFormElement.prototype.submit.call(form);
  }
});
// Windows of a log: dragged in the middle they move, at an end only that end; their fields follow.
let held = null;
const seconds = event => {
  const svg = held.rect.ownerSVGElement, { from, to, left, right, width } = svg.dataset;
  const box = svg.getBoundingClientRect(), x = (event.clientX - box.left) * width / box.width;
  return Number(from) + (x - left) / (width - left - right) * (to - from);
};
document.addEventListener("pointerdown", event => {
  const rect = event.target.closest("[data-window]");
  if (!rect) return;
  const fields = ["start", "end"].map(end => document.getElementsByName(`window/${rect.dataset.window}/${end}`)[0]);
  held = { rect, fields, ends: fields.map(field => Number(field.value)), pointer: event.pointerId };
  held.at = seconds(event);
  const edge = (held.ends[1] - held.ends[0]) * 0.2;
  held.moves = [held.at < held.ends[1] - edge, held.at > held.ends[0] + edge];
  event.preventDefault();
});
document.addEventListener("pointermove", event => {
  if (!held || event.pointerId !== held.pointer) return;
  const by = seconds(event) - held.at, { from, to, left, right, width } = held.rect.ownerSVGElement.dataset;
  const place = held.ends.map((end, i) => Math.min(Math.max(end + (held.moves[i] ? by : 0), from), to));
  if (place[0] >= place[1]) return;
  const across = place.map(time => Number(left) + (time - from) / (to - from) * (width - left - right));
  for (const rect of document.querySelectorAll(`[data-window="${held.rect.dataset.window}"]`)) {
    rect.setAttribute("x", across[0]);
    rect.setAttribute("width", across[1] - across[0]);
    rect.classList.add("moved");
  }
  held.fields.forEach((field, i) => { field.value = place[i].toFixed(3); });
});
document.addEventListener("pointerup", () => {
  if (!held) return;
  const { form } = held.fields[0];
  held = null;
  htmx.trigger(form, "moved");
});
