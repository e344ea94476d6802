// Rows of the panel, one for each light: on or off, and for the chosen one brightness, colour and removal.
import { isLamp, strengthKey } from "./light_list.js";

const COOLEST = 10000;
const WARMEST = 1800; // kelvin

const encode = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
const decode = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);

/** Hue of linear RGB as #rrggbb. */
export function hex(rgb) {
  const most = Math.max(...rgb, 1e-6);
  return `#${rgb.map((v) => Math.round(255 * encode(v / most)).toString(16).padStart(2, "0")).join("")}`;
}

const fromHex = (text) => [1, 3, 5].map((k) => decode(parseInt(text.slice(k, k + 2), 16) / 255));

const made = (tag, properties = {}) => Object.assign(document.createElement(tag), properties);

export function connectLightRows(viewer) {
  const list = document.getElementById("lights");
  let shown = "";
  let told = "";

  function draw() {
    const { lights } = viewer;
    const key = JSON.stringify([lights.shown.map((item) => item.id), viewer.selected, lights.hour === null, lights.restored]);
    if (key !== shown) {
      shown = key;
      list.replaceChildren(...lights.shown.map(makeRow));
      if (!lights.shown.length) list.append(made("li", { className: "kind", textContent: "No lamps" }));
    }
    for (const row of list.children) row.update?.();
    const item = lights.find(viewer.selected);
    const why = item?.on ? unseen(item) : "";
    if (why && why !== told) viewer.say(why);
    told = why;
  }

  function unseen(item) {
    const why = viewer.whyUnseen(item);
    return why ? `${viewer.lights.name(item)} changes nothing here: ${why}.` : "";
  }

  function makeRow(item) {
    const { lights } = viewer;
    const row = made("li");
    const selected = viewer.selected === item.id;
    const on = made("input", { type: "checkbox", checked: item.on, ariaLabel: `${lights.name(item)} is on` });
    const swatch = made("span", { className: "swatch" });
    const name = made("button", { type: "button", className: "name", textContent: lights.name(item) });
    name.setAttribute("aria-expanded", selected);
    const value = made("output");
    const head = made("div", { className: "light-head" });
    head.append(on, swatch, name, value);
    row.append(head);
    row.classList.toggle("selected", selected);
    on.addEventListener("change", () => {
      item.on = on.checked;
      viewer.change("lights");
    });
    name.addEventListener("click", () => {
      viewer.selected = selected ? null : item.id;
      viewer.change("display");
    });
    const body = selected ? makeBody(item) : null;
    if (body) row.append(body);
    row.update = () => {
      const strength = item.entry[strengthKey(item.entry)];
      const digits = strength < 10 ? 1 : 0;
      value.textContent = `${strength.toFixed(digits)} ${strengthKey(item.entry) === "illuminance" ? "lx" : "lm"}`;
      swatch.style.background = hex(lights.color(item));
      row.classList.toggle("off", !item.on);
      on.checked = item.on;
      body?.update();
    };
    return row;
  }

  function makeBody(item) {
    const { lights } = viewer;
    const body = made("div", { className: "light-body" });
    const key = strengthKey(item.entry);
    // Brightness is seen as a ratio: the slider goes by its cube root.
    const brightness = slider("Brightness", { min: 0, max: 1, step: 0.005 }, (share) => {
      item.entry[key] = Number((item.most * share ** 3).toPrecision(3));
    });
    const warmth = slider("Temperature", { min: WARMEST, max: COOLEST, step: 50 }, (kelvin) => lights.setTemperature(item, kelvin));
    const color = made("input", { type: "color", ariaLabel: "Colour" });
    color.addEventListener("input", () => {
      lights.setColor(item, fromHex(color.value));
      viewer.change("lights");
    });
    const hue = made("div", { className: "row" });
    hue.append(made("label", { textContent: "Colour" }), color);
    body.append(brightness.row, warmth.row, hue);
    if (isLamp(item.entry)) {
      const remove = made("button", { type: "button", textContent: "Remove" });
      remove.addEventListener("click", () => {
        lights.remove(item.id);
        viewer.selected = null;
        viewer.change("lights");
      });
      body.append(remove);
    }
    const why = made("p", { className: "why" });
    body.append(why);
    body.update = () => {
      why.textContent = unseen(item);
      why.hidden = !why.textContent;
      brightness.input.value = Math.cbrt(item.entry[key] / item.most);
      const { temperature } = item.entry;
      warmth.input.value = temperature ?? 4000;
      warmth.input.setAttribute("aria-valuetext", temperature ? `${Math.round(temperature)} kelvin` : "by colour");
      warmth.output.textContent = temperature ? `${Math.round(temperature)} K` : "";
      color.value = hex(lights.color(item));
    };
    return body;
  }

  function slider(text, range, set) {
    const row = made("div", { className: "row" });
    const label = made("label", { textContent: text });
    const input = made("input", { type: "range", ...range, ariaLabel: text });
    const output = made("output");
    input.addEventListener("input", () => {
      set(Number(input.value));
      viewer.change("lights");
    });
    row.append(label, input, output);
    return { row, input, output };
  }

  viewer.addEventListener("change", draw);
  draw();
}
