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
