// Panels of a tour: daylight, kinds of lamps, windows, furniture, diffusion, downloads, frames that arrive.
import { box, button, choice, date, made, section, slider } from "./fields.js";
import { anchorOf, angleOf, placePiece } from "./handles.js";
import { loadPage } from "./scene.js";
import { handOver } from "./take_home.js";

const element = (id) => document.getElementById(id);
const clock = (hour) => `${Math.floor(hour)}:${String(Math.round((hour % 1) * 60)).padStart(2, "0")}`;
const capital = (text) => text[0].toUpperCase() + text.slice(1);
const signed = (value, digits, unit) => `${value > 0 ? "+" : ""}${value.toFixed(digits)} ${unit}`;

export function connectTourPanels(viewer) {
  const { page } = viewer;
  const { server } = page;
  const first = daylight(viewer);
  element("sun").replaceWith(first);
  const kinds = choice("Kind", Object.keys(server.lamps).map((kind) => [kind, capital(kind)]), (kind) => { viewer.lights.kind = kind; });
  element("put").before(kinds.element);
  element("put-mode").options[0].textContent = "On a surface";
  const lights = element("lights").parentElement;
  lights.after(listed(viewer, WINDOWS), ...(server.live ? [] : [listed(viewer, FURNITURE)]));
  for (const id of ["save", "save-picture", "save-video"]) element(id).hidden = true;
  element("speed").before(downloads(viewer), diffusion(viewer));
  if (server.live) first.before(arriving(viewer));
  const more = server.shown.filter((name) => !["relit", ...[...element("stages").options].map(({ value }) => value)].includes(name));
  element("stages").append(...more.map((name) => new Option(capital(name), name)));
  for (const text of server.notices) viewer.say(text);
}

function daylight(viewer) {
  const { lights } = viewer;
  const set = (name) => (value) => {
    lights.plain[name] = value;
    viewer.change("lights");
  };
  const fields = {
    hour: slider("Hour", { min: 0, max: 24, step: 0.25 }, set("hour"), clock),
    day: date("Date", set("day")),
    weather: choice("Weather", viewer.page.server.weather.map((name) => [name, capital(name)]), set("weather")),
    latitude: slider("Latitude", { min: -90, max: 90, step: 1 }, set("latitude"), (value) => `${Math.abs(value)}° ${value < 0 ? "S" : "N"}`),
    north: slider("North", { min: 0, max: 359, step: 1 }, set("north"), (value) => `${value}°`),
    open_sky: box("Open sky in place of windows", set("open_sky")),
  };
  const said = made("p", { className: "said" });
  viewer.addEventListener("change", () => {
    for (const [name, field] of Object.entries(fields)) {
      const value = lights.plain[name];
      field.show(name === "north" ? ((value % 360) + 360) % 360 : value);
    }
    said.textContent = lights.outside?.said ?? "";
  });
  return section("daylight", "Daylight", [], ...Object.values(fields).map((field) => field.element), said);
}

const WINDOWS = {
  id: "windows", field: "windows", title: "Windows", tool: "window", add: "Draw a window", name: "Window", none: "No windows: light from outside under an open sky only",
  body(viewer, thing) {
    const size = (text, name, max) => {
      const field = slider(text, { min: 0.1, max, step: 0.05 }, (value) => {
        thing[name] = value;
        viewer.change("lights");
      }, (value) => `${value.toFixed(2)} m`);
      return { ...field, refresh: () => field.show(thing[name]) };
    };
    return [size("Width", "width", 5), size("Height", "height", 4)];
  },
  remove: "Remove",
};

const FURNITURE = {
  id: "furniture", field: "pieces", title: "Furniture", tool: "furniture", add: "Pick a piece", name: "Piece", none: "Pick a piece to move it or take it away",
  body(viewer, thing) {
    const turn = slider("Turned", { min: -180, max: 180, step: 1 }, (degrees) => {
      placePiece(thing, viewer.page.scene.up, (degrees * Math.PI) / 180, anchorOf(thing));
      viewer.change("lights");
    }, (value) => `${value}°`);
    const raise = slider("Raised", { min: -1, max: 2, step: 0.01 }, (metres) => {
      const { up } = viewer.page.scene;
      const from = anchorOf(thing);
      const now = up.reduce((sum, v, k) => sum + v * (from[k] - centre(thing)[k]), 0);
      placePiece(thing, up, angleOf(thing, up), from.map((v, k) => v + (metres - now) * up[k]));
      viewer.change("lights");
    }, (value) => signed(value, 2, "m"));
    const away = box("Taken away", (removed) => {
      thing.removed = removed;
      viewer.change("lights");
    });
    const { up } = viewer.page.scene;
    return [
      { ...turn, refresh: () => turn.show(Math.round((angleOf(thing, up) * 180) / Math.PI)) },
      { ...raise, refresh: () => raise.show(up.reduce((sum, v, k) => sum + v * (anchorOf(thing)[k] - centre(thing)[k]), 0)) },
      { ...away, refresh: () => away.show(Boolean(thing.removed)) },
    ];
  },
  remove: "Put back",
};
const centre = (piece) => piece.centre ?? piece.seed;

/** List of windows or of furniture, with the controls of the selected one. */
function listed(viewer, kind) {
  const { lights } = viewer;
  const list = made("ul", { className: "things" });
  const add = button(kind.add, ({ detail }) => {
    if (!detail) { // by keyboard: in the middle of the picture
      viewer.useTool(kind.tool, [{ x: viewer.page.size[1] / 2, y: viewer.page.size[0] / 2 }]);
      return;
    }
    viewer.tool = viewer.tool === kind.tool ? null : kind.tool;
    viewer.adding = false;
    viewer.change("display");
  });
  let shown = "";
  let refreshes = [];
  viewer.addEventListener("change", () => {
    const things = lights.plain[kind.field];
    add.setAttribute("aria-pressed", viewer.tool === kind.tool);
    const selected = viewer.thing?.field === kind.field ? viewer.thing.index : -1;
    const key = JSON.stringify([things.length, selected, lights.restored ?? 0]);
    if (key !== shown) {
      shown = key;
      refreshes = [];
      list.replaceChildren(...things.map((thing, index) => entry(thing, index, index === selected)));
      if (!things.length) list.append(made("li", { className: "kind", textContent: kind.none }));
    }
    for (const refresh of refreshes) refresh();
  });

  function entry(thing, index, selected) {
    const name = made("button", { type: "button", className: "name", textContent: `${kind.name} ${index + 1}` });
    name.setAttribute("aria-expanded", selected);
    name.addEventListener("click", () => {
      viewer.thing = selected ? null : { field: kind.field, index };
      viewer.change("display");
      list.children[index]?.querySelector(".name")?.focus();
    });
    const result = made("li", { className: selected ? "selected" : "" }, made("div", { className: "light-head thing" }, name));
    if (!selected) return result;
    const fields = kind.body(viewer, thing);
    refreshes = fields.map((field) => field.refresh);
    const body = made("div", { className: "light-body" }, ...fields.map((field) => field.element));
    body.append(button(kind.remove, () => {
      lights.plain[kind.field].splice(index, 1);
      viewer.thing = null;
      viewer.change("lights");
      add.focus();
    }));
    result.append(body);
    return result;
  }

  return section(kind.id, kind.title, [add], list, ...(kind.field === "pieces" ? [bringing(viewer)] : []));
}

const PART = 36_000; // bytes of a file in one message

/** Button that brings a mesh into the room. */
function bringing(viewer) {
  const input = made("input", { type: "file", accept: ".ply,.obj,.glb", hidden: true });
  const bring = button("Bring a mesh", () => input.click());
  input.addEventListener("change", async () => {
    const [file] = input.files;
    input.value = "";
    if (!file) return;
    bring.disabled = true;
    try {
      const { new: piece } = await send(viewer, file);
      const { pieces } = viewer.lights.plain; // undo may have replaced them meanwhile
      pieces.push(piece);
      viewer.thing = { field: "pieces", index: pieces.length - 1 };
      viewer.change("lights");
    } catch (error) {
      viewer.say(error.message);
    } finally {
      bring.disabled = false;
    }
  });
  return made("div", { className: "buttons" }, bring, input);
}

/** Send a file to the server in parts; its last answer. */
async function send(viewer, file) {
  let answer = null;
  for (let from = 0; from < file.size || !from; from += PART) {
    const bytes = new Uint8Array(await file.slice(from, from + PART).arrayBuffer());
    const part = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
    const rest = Math.max(0, file.size - from - bytes.length);
    answer = await viewer.connection.ask("bring", { ...viewer.state(), name: file.name, part, rest });
  }
  return answer;
}

function diffusion(viewer) {
  const { lights } = viewer;
  const { schedules } = viewer.page.server;
  const set = (name) => (value) => {
    lights.refinement[name] = name === "schedule" && value === schedules[0] ? "" : value;
    viewer.change("display");
  };
  const schedule = choice("Schedule", schedules, set("schedule"));
  const kappa = slider("κ × 10^", { min: -1.5, max: 1.5, step: 0.05 }, set("kappa"), (value) => value.toFixed(2));
  const steps = slider("Steps ×", { min: 0, max: 4, step: 0.5 }, set("steps"), (value) => value.toFixed(1));
  const show = () => {
    schedule.show(lights.refinement.schedule || schedules[0]);
    kappa.show(lights.refinement.kappa);
    steps.show(lights.refinement.steps);
  };
  viewer.addEventListener("change", show);
  return made("details", { id: "diffusion" }, made("summary", { textContent: "Diffusion" }), schedule.element, kappa.element, steps.element);
}

const FILES = { png: "Picture", exr: "Picture as EXR", lights: "Lights file", mesh: "Mesh", page: "Page to send", video: "Video" };

function downloads(viewer) {
  const fetchFile = async (task) => {
    if (task === "page") viewer.say("A page is being made that opens by itself; furniture in it is where it was scanned.");
    if (task === "video") viewer.say(`${viewer.frames.count} frames are being relit; you can go on meanwhile.`);
    try {
      const { file, written, content } = await viewer.connection.ask(task, viewer.state());
      handOver(new Blob([content]), file);
      viewer.say(`Saved; the server has it as ${written}, too.`);
    } catch (error) {
      viewer.say(error.message);
    }
  };
  const files = Object.entries(FILES).filter(([task]) => task !== "page" || viewer.page.server.page);
  const buttons = files.map(([task, text]) => button(text, () => fetchFile(task)));
  return section("downloads", "Take home", [], made("div", { className: "buttons many" }, ...buttons));
}

function arriving(viewer) {
  const { page, frames, connection } = viewer;
  viewer.follow = true;
  const follow = box("Follow the newest frame", (on) => {
    viewer.follow = on;
    if (on) viewer.goTo(frames.count - 1);
  });
  follow.show(true);
  viewer.frame = frames.count - 1;
  const take = async ({ frames: count, entries, numbering, bounds }) => {
    let from = count - entries.length;
    const overtaken = from && (numbering !== page.server.numbering || from > page.frames.length); // news in between
    if (overtaken) {
      ({ frames: entries, server: { numbering }, scene: { bounds } } = await loadPage());
      from = 0;
    }
    page.scene.bounds.splice(0, 2, ...bounds); // of a camera that flies, too
    if (!from) frames.forget();
    page.frames.splice(from, page.frames.length, ...entries);
    page.server.numbering = numbering;
    element("subtitle").textContent = `${page.frames.length} frames, ${page.size[1]} × ${page.size[0]}`;
    viewer.frame = Math.min(viewer.frame, page.frames.length - 1);
    viewer.remote.asked = null; // the surface is another one
    if (viewer.follow && !viewer.flying && !viewer.playing) viewer.frame = page.frames.length - 1;
    viewer.change("camera");
  };
  let taken = Promise.resolve();
  connection.addEventListener("news", ({ detail }) => {
    if (detail.entries) taken = taken.then(() => take(detail)).catch((error) => viewer.say(error.message));
  });
  return section("arriving", "Live", [], follow.element);
}
