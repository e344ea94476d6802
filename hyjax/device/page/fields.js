// Labelled controls of the panel.
let number = 0;

/** An element with properties and children. */
export function made(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

function row(text, input, output) {
  number += 1;
  input.id = `field-${number}`;
  return made("div", { className: "row" }, made("label", { textContent: text, htmlFor: input.id, title: text }), input, ...(output ? [output] : []));
}

/** A slider; `set` gets its number, `shown` makes the text beside it. Its `show` shows a number that it was not given by hand. */
export function slider(text, range, set, shown = (value) => String(value)) {
  const input = made("input", { type: "range", ...range });
  const output = made("output");
  const name = () => {
    output.textContent = shown(Number(input.value));
    input.setAttribute("aria-valuetext", output.textContent);
  };
  input.addEventListener("input", () => {
    name();
    set(Number(input.value));
  });
  const show = (value) => {
    input.value = value;
    name();
  };
  return { element: row(text, input, output), input, show };
}

/** A list to choose from: texts, or [value, text]. */
export function choice(text, options, set) {
  const input = made("select");
  input.append(...options.map((option) => (Array.isArray(option) ? new Option(option[1], option[0]) : new Option(option, option))));
  input.addEventListener("change", () => set(input.value));
  const element = row(text, input);
  element.classList.add("wide");
  return { element, input, show: (value) => { input.value = value; } };
}

/** A date. */
export function date(text, set) {
  const input = made("input", { type: "date", min: "1900-01-01", max: "2100-12-31" });
  input.addEventListener("change", () => input.value && input.checkValidity() && set(input.value));
  const element = row(text, input);
  element.classList.add("wide");
  return { element, input, show: (value) => { if (document.activeElement !== input) input.value = value; } };
}

/** A box to tick. */
export function box(text, set) {
  const input = made("input", { type: "checkbox" });
  input.addEventListener("change", () => set(input.checked));
  return { element: made("label", { className: "box" }, input, ` ${text}`), input, show: (value) => { input.checked = value; } };
}

export function button(text, click, properties = {}) {
  const element = made("button", { type: "button", textContent: text, ...properties });
  element.addEventListener("click", click);
  return element;
}

/** A part of the panel. */
export function section(id, title, head, ...children) {
  return made("section", { id }, made("h2", {}, made("span", { textContent: title }), ...head), ...children);
}
