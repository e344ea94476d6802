// Page of hyjax/exploration/widget.py: pictures, lamps to drag, and a control of every choice.

const SLIDER_STEPS = 1000;
const NAMES = { point: "Lamp", spot: "Spot", rect: "Window light", directional: "Sun", ambient: "Ambient light" };
const nameOf = (light) => NAMES[light.kind] ?? light.kind;
const LADDER = [["steps", "steps", 0, 32, false], ["kappa", "κ", 0.002, 0.5, true],
  ["lam", "λ", 0.01, 0.2499, false], ["fidelity", "α", 0.01, 3, true]];
const CASCADES = { schedule: "Cascade of the light", shadow_schedule: "Shadow pass" };

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

const short = (value) => (value === null || value === undefined ? "–" : String(Number(Number(value).toPrecision(3))));

// Slider with its number; says each value while it moves (draft) and when it rests.
function slider({ label, aria = label, title = "", low, high, log = false, whole = false, change }) {
  const scale = log
    ? { to: (v) => Math.log(Math.max(v, low) / low) / Math.log(high / low), from: (s) => low * (high / low) ** s }
    : { to: (v) => (v - low) / (high - low), from: (s) => low + s * (high - low) };
  const steps = whole ? high - low : SLIDER_STEPS;
  const range = element("input", { type: "range", min: 0, max: steps, step: 1, ariaLabel: aria });
  const shown = element("output");
  let held = false;
  const value = () => {
    const found = scale.from(range.value / steps);
    return whole ? Math.round(found) : Number(found.toPrecision(4));
  };
  const say = (draft) => { shown.textContent = short(value()); change(value(), draft); };
  range.addEventListener("input", () => { held = true; say(true); });
  range.addEventListener("change", () => { held = false; say(false); });
  const set = (v) => {
    range.disabled = v === null || v === undefined;
    shown.textContent = short(v);
    if (!held && !range.disabled) range.value = Math.round(steps * Math.min(1, Math.max(0, scale.to(v))));
  };
  return { node: element("label", { className: "hyjax-slider", title }, element("span", {}, label), range, shown), set };
}

function list({ label, title = "", values, change }) {
  const select = element("select", { ariaLabel: label });
  const fill = (options) => select.replaceChildren(
    ...options.map(([value, text]) => element("option", { value }, text)));
  fill(values);
  select.addEventListener("change", () => change(select.value));
  const set = (value) => {
    if (![...select.options].some((option) => option.value === value)) {
      select.append(element("option", { value, disabled: true }, value || "own"));
    }
    select.value = value;
  };
  return { node: element("label", { title }, element("span", {}, label), select), set, fill };
}

function switchOf({ label, title = "", change }) {
  const box = element("input", { type: "checkbox", ariaLabel: label });
  box.addEventListener("change", () => change(box.checked));
  return { node: element("label", { title }, element("span", {}, label), box), set: (on) => { box.checked = on; } };
}

// Text or a whole number; empty is None where a choice may have none.
function field({ label, title = "", number = false, none = false, values = [], change }) {
  const input = element("input", { type: number ? "number" : "text", ariaLabel: label });
  if (values.length) input.placeholder = values.join(", ");
  let typing = false; // until it is said, what is typed is not overwritten
  input.addEventListener("input", () => { typing = true; });
  input.addEventListener("blur", () => { typing = false; });
  input.addEventListener("change", () => {
    typing = false;
    const text = input.value.trim();
    change(none && !text ? null : number ? Number(text) : text);
  });
  return {
    node: element("label", { title }, element("span", {}, label), input),
    set: (value) => { if (!typing) input.value = value === null ? "" : value; },
  };
}

function controlOf(row, change) {
  const common = { label: row.label, title: row.help, change };
  if (row.kind === "switch") return switchOf(common);
  if (row.kind === "list") return list({ ...common, values: row.values.map((value) => [value, value]) });
  if (row.kind === "slider") {
    return slider({ ...common, low: row.low, high: row.high, log: row.log, whole: row.step === 1 });
  }
  return field({ ...common, number: row.kind === "number", none: row.none, values: row.values || [] });
}

function render({ model, el }) {
  const send = (kind, content = {}) => model.send({ kind, ...content });
  const state = () => model.get("state");
  const urls = {};
  el.classList.add("hyjax-explorer");

  // Pictures.
  const photo = element("img", { className: "hyjax-photo", alt: "photo", draggable: false });
  const relit = element("img", { className: "hyjax-relit", alt: "relit", draggable: false });
  const bar = element("div", { className: "hyjax-bar" });
  const lampLayer = element("div", { className: "hyjax-lamps" });
  const stage = element("div", { className: "hyjax-stage" }, photo, relit, bar, lampLayer);
  const sheet = element("img", { className: "hyjax-sheet", alt: "side by side" });
  const message = element("p", { className: "hyjax-message", role: "alert" });
  const times = element("p", { className: "hyjax-times" });
  const judged = element("p", { className: "hyjax-judged", ariaLabel: "scores" });
  const wiper = element("input", { type: "range", min: 0, max: 1000, ariaLabel: "photo | relit" });
  const wipe = (share) => {
    relit.style.clipPath = `inset(0 0 0 ${100 * share}%)`;
    bar.style.left = `${100 * share}%`;
    wiper.value = Math.round(1000 * share);
  };
  wiper.addEventListener("input", () => wipe(wiper.value / 1000));

  // Controls.
  const frame = slider({ label: "frame", low: 0, high: Math.max(1, state().frames - 1), whole: true,
    change: (value, draft) => send("frame", { value, draft }) });
  const setup = list({ label: "lights", values: state().setups.map((name) => [name, name]),
    change: (value) => send("lights", { value }) });
  const preset = list({ label: "configuration", values: state().presets.map((name) => [name, name]),
    change: (value) => send("preset", { value }) });
  const view = list({ label: "show", values: Object.entries(state().views), change: (value) => send("view", { value }) });
  const keep = element("button", { type: "button", title: "Compare what follows with this configuration" }, "keep as B");
  keep.addEventListener("click", () => send("keep"));
  const swap = element("button", { type: "button" }, "swap A, B");
  swap.addEventListener("click", () => send("swap"));
  const copy = element("button", { type: "button" }, "copy as Python");
  const code = element("textarea", { className: "hyjax-code", readOnly: true, hidden: true, ariaLabel: "Python" });
  copy.addEventListener("click", async () => {
    code.hidden = false;
    code.value = model.get("code");
    code.select();
    await navigator.clipboard?.writeText(code.value).catch(() => {});
  });

  const lampRows = element("div");
  const folder = (name, open, ...children) => element("details", { open }, element("summary", {}, name), ...children);
  const groups = new Map();
  const choices = {};
  for (const row of model.get("controls")) {
    choices[row.name] = controlOf(row, (value, draft = false) => send("choice", { name: row.name, value, draft }));
    if (!groups.has(row.group)) groups.set(row.group, []);
    groups.get(row.group).push(choices[row.name].node);
  }
  const ladderNodes = Object.fromEntries(Object.keys(CASCADES).map((name) => [name, element("div")]));
  const ladderOf = Object.fromEntries(Object.entries(CASCADES).map(([name, heading]) => [heading, ladderNodes[name]]));
  const folders = [...groups].map(([name, nodes]) => folder(
    name, name in ladderOf, ...(name in ladderOf ? [ladderOf[name]] : []), ...nodes));
  el.replaceChildren(
    element("div", { className: "hyjax-main" }, stage, wiper, sheet, message, times, judged, frame.node,
      element("div", { className: "hyjax-buttons" }, keep, swap, copy), code),
    element("div", { className: "hyjax-controls" }, setup.node, preset.node, view.node, folder("Lamps", true, lampRows), ...folders));

  // Ladders: a row a level, made anew when the levels, or the most steps that they can have, change.
  const ladders = {};
  function showLadder(name) {
    const levels = state().ladders[name];
    const key = levels.map((level) => [level.factor, level.most_steps]).join();
    if (ladders[name]?.key !== key) {
      const rows = levels.map((level, index) => LADDER.map(([key, label, low, high, log]) => slider({
        label: `1/${level.factor} ${label}`, aria: `${name === "schedule" ? "" : "shadows "}1/${level.factor} ${label}`, low, high: key === "steps" ? level.most_steps : high, log,
        whole: key === "steps", change: (value, draft) => send("level", { cascade: name, index, key, value, draft }),
      })));
      ladders[name] = { key, rows };
      ladderNodes[name].replaceChildren(...rows.map((row) => element(
        "div", { className: "hyjax-level" }, ...row.map((each) => each.node))));
    }
    levels.forEach((level, index) => LADDER.forEach(([key], k) => ladders[name].rows[index][k].set(level[key])));
  }

  // Lamps: a row and, where it is in the picture, a handle for each.
  let lamps = { key: "", kinds: "", rows: [], handles: [] };
  let dragged = -1;
  function makeLamps(found) {
    const rows = found.map((lamp, index) => slider({
      label: `${index} ${nameOf(lamp)}, ${lamp.unit}`, low: 0, high: 4 * Math.max(lamp.strength, 1),
      change: (value, draft) => send("strength", { index, value, draft }) }));
    const handles = found.map((lamp, index) => {
      const handle = element("div", { className: "hyjax-lamp", title: `${index} ${nameOf(lamp)}` }, String(index));
      const place = (event) => {
        const box = stage.getBoundingClientRect();
        return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
      };
      handle.addEventListener("pointerdown", (event) => { dragged = index; handle.setPointerCapture(event.pointerId); event.preventDefault(); });
      handle.addEventListener("pointermove", (event) => {
        if (dragged !== index) return;
        const value = place(event);
        handle.style.left = `${100 * value[0]}%`;
        handle.style.top = `${100 * value[1]}%`;
        send("place", { index, value, draft: true });
      });
      handle.addEventListener("pointerup", (event) => {
        if (dragged !== index) return;
        dragged = -1;
        send("place", { index, value: place(event), draft: false });
      });
      return handle;
    });
    lampRows.replaceChildren(...rows.map((row) => row.node));
    lampLayer.replaceChildren(...handles);
    return { rows, handles };
  }
  function showLamps() {
    const found = state().lamps;
    const kinds = JSON.stringify(found.map((lamp) => lamp.kind));
    const key = JSON.stringify([state().lights, kinds]);
    const own = !state().lights && lamps.kinds === kinds;
    if (key !== lamps.key && !own) lamps = { key, kinds, ...makeLamps(found) };
    found.forEach((lamp, index) => {
      const handle = lamps.handles[index];
      lamps.rows[index].set(lamp.strength);
      const inside = lamp.place && lamp.place.every((share) => share >= 0 && share <= 1);
      handle.hidden = !inside;
      handle.style.background = `rgb(${lamp.color.join()})`;
      if (inside && dragged !== index) [handle.style.left, handle.style.top] = lamp.place.map((s) => `${100 * s}%`);
    });
  }

  function showState() {
    frame.set(state().frame);
    setup.set(state().lights);
    preset.set(state().preset);
    view.set(state().view);
    swap.disabled = !state().other;
    for (const [name, value] of Object.entries(state().values)) choices[name]?.set(value);
    Object.keys(CASCADES).forEach(showLadder);
    showLamps();
    const wiped = state().view === "wipe";
    stage.hidden = wiper.hidden = !wiped;
    sheet.hidden = wiped;
  }
  function showPicture(name, image) {
    const content = model.get(name);
    if (!content?.byteLength) return;
    if (urls[name]) URL.revokeObjectURL(urls[name]);
    urls[name] = URL.createObjectURL(new Blob([content], { type: "image/jpeg" }));
    image.src = urls[name];
  }
  const showTimes = () => {
    const taken = model.get("times");
    const total = taken.reduce((sum, [, ms]) => sum + ms, 0);
    times.textContent = `${total.toFixed(0)} ms: ${taken.map(([stage_, ms]) => `${stage_} ${ms.toFixed(0)}`).join(", ")}`;
  };
  const followed = {
    state: showState, picture: () => showPicture("picture", relit), photo: () => showPicture("photo", photo),
    sheet: () => showPicture("sheet", sheet), times: showTimes, code: () => { code.value = model.get("code"); },
    message: () => { message.textContent = model.get("message"); },
    judged: () => { judged.replaceChildren(...(model.get("judged") || []).flatMap((line) => [line, element("br")])); },
  };
  for (const [name, show] of Object.entries(followed)) { model.on(`change:${name}`, show); show(); }
  wipe(0.5);
  send("ready");
  return () => {
    for (const [name, show] of Object.entries(followed)) model.off(`change:${name}`, show);
    Object.values(urls).forEach((url) => URL.revokeObjectURL(url));
  };
}

export default { render };
