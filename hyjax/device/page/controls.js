// The panel and the bar below the picture: controls that change what the viewer shows.
import { STAGES } from "./display.js";
import { connectHistory } from "./history.js";
import { connectLightRows } from "./light_rows.js";
import { connectPresets } from "./presets.js";
import { connectTakeHome } from "./take_home.js";

const element = (id) => document.getElementById(id);
const PLAY = "M4 2.5v11l9-5.5z";
const PAUSE = "M4 2.5h3v11H4zM9 2.5h3v11H9z";
const NOTICE_SECONDS = 6;
const MOST_LEFT = 1.5; // of a source of the photos

export function connectControls(viewer) {
  const { page } = viewer;
  const [height, width] = page.size;
  const count = viewer.frames.count;
  element("subtitle").textContent = `${count} frame${count === 1 ? "" : "s"}, ${width} × ${height}`;
  connectTransport(viewer);
  connectWipe(viewer);
  connectSun(viewer);
  connectAdding(viewer);
  connectSources(viewer);
  connectPicture(viewer);
  connectTakeHome(viewer);
  connectPresets(viewer);
  connectSpeed(viewer);
  connectLightRows(viewer);
  connectNotices(viewer);
  connectHistory(viewer);
}

function connectTransport(viewer) {
  const scrub = element("scrub");
  scrub.addEventListener("input", () => {
    viewer.playing = false;
    viewer.goTo(Number(scrub.value));
  });
  element("play").addEventListener("click", () => {
    viewer.playing = !viewer.playing;
    viewer.flying = null;
    viewer.change("camera");
  });
  const stages = element("stages");
  stages.append(...STAGES.map((stage) => new Option(stage[0].toUpperCase() + stage.slice(1), stage)));
  stages.addEventListener("change", () => {
    viewer.stage = stages.value;
    viewer.change("display");
  });
  element("land").addEventListener("click", () => viewer.land());
  element("fly").addEventListener("click", () => viewer.fly());
  viewer.addEventListener("change", () => {
    const last = viewer.frames.count - 1; // frames of a live tour arrive
    scrub.max = last;
    scrub.disabled = last === 0;
    element("play").disabled = last === 0;
    scrub.value = viewer.frame;
    element("frame-label").textContent = `${viewer.frame + 1} / ${last + 1}`;
    element("play-shape").setAttribute("d", viewer.playing ? PAUSE : PLAY);
    element("play").setAttribute("aria-label", viewer.playing ? "Pause" : "Play the frames");
    element("land").hidden = !viewer.flying;
    element("fly").hidden = Boolean(viewer.flying);
    document.body.classList.toggle("flying", Boolean(viewer.flying));
    scrub.setAttribute("aria-valuetext", `frame ${viewer.frame + 1} of ${last + 1}`);
    element("wipe").hidden = Boolean(viewer.flying) || viewer.stage === "photo";
    element("hint").hidden = !viewer.adding && !viewer.flying;
    const fine = matchMedia("(pointer: fine)").matches;
    const flight = fine
      ? "Drag, or Shift and arrows, to look around; W A S D, Q E or the wheel to move"
      : "Drag to look around, two fingers to move";
    element("hint").textContent = viewer.adding ? "Choose a place for the lamp" : flight;
    document.body.classList.toggle("adding", Boolean(viewer.adding));
    element("add").setAttribute("aria-pressed", Boolean(viewer.adding));
  });
}

function connectWipe(viewer) {
  const wipe = element("wipe");
  const set = (share) => {
    viewer.wipe = Math.max(0, Math.min(1, share));
    viewer.change("display");
  };
  let grip = 0; // share of the width from the wipe to where its handle is held
  const shareAt = ({ clientX }) => {
    const box = element("picture").getBoundingClientRect();
    return (clientX - box.left) / box.width;
  };
  wipe.addEventListener("pointerdown", (event) => {
    wipe.setPointerCapture(event.pointerId);
    grip = shareAt(event) - viewer.wipe;
    event.preventDefault();
  });
  wipe.addEventListener("pointermove", (event) => {
    if (!wipe.hasPointerCapture(event.pointerId)) return;
    set(shareAt(event) - grip);
  });
  wipe.addEventListener("keydown", ({ code }) => {
    if (code === "ArrowLeft" || code === "ArrowRight") set(viewer.wipe + (code === "ArrowLeft" ? -0.05 : 0.05));
    if (code === "Home" || code === "End") set(Number(code === "End"));
  });
  viewer.addEventListener("change", () => {
    wipe.style.left = `${100 * viewer.wipe}%`;
    wipe.firstElementChild.style.left = `${5 + 18 * (1 - 2 * viewer.wipe)}px`; // inside at both edges
    wipe.setAttribute("aria-valuenow", Math.round(100 * viewer.wipe));
    wipe.setAttribute("aria-valuetext", `${Math.round(100 * viewer.wipe)} % photo`);
  });
}

function connectSun(viewer) {
  const { sun } = viewer.page;
  if (!sun || viewer.page.server) return;
  element("sun").hidden = false;
  const hour = element("hour");
  const on = element("sun-on");
  hour.max = sun.rows.at(-1).hour;
  const set = () => {
    viewer.lights.hour = on.checked ? Number(hour.value) : null;
    viewer.change("lights");
  };
  on.addEventListener("change", set);
  hour.addEventListener("input", () => {
    on.checked = true;
    set();
  });
  viewer.addEventListener("change", () => {
    const { hour: now } = viewer.lights;
    on.checked = now !== null;
    if (now !== null) hour.value = now;
    const value = Number(hour.value);
    element("hour-label").textContent = on.checked ? `${Math.floor(value)}:${value % 1 ? "30" : "00"}` : "";
  });
}

function connectAdding(viewer) {
  const { up, bounds } = viewer.page.scene; // which grow with frames that arrive
  const room = () => Math.abs(up.reduce((sum, v, k) => sum + v * (bounds[1][k] - bounds[0][k]), 0));
  const height = element("height");
  const setMost = () => { height.max = Math.max(0.5, room()).toFixed(2); };
  setMost();
  height.value = Math.min(1.6, 0.7 * room());
  viewer.addEventListener("change", setMost);
  element("add").addEventListener("click", ({ detail }) => {
    if (!detail) { // by keyboard: in the middle of the picture
      viewer.addLamp(viewer.page.size[1] / 2, viewer.page.size[0] / 2).catch((error) => viewer.say(error.message));
      return;
    }
    viewer.adding = !viewer.adding;
    viewer.tool = null;
    viewer.change("display");
  });
  const set = () => {
    const chosen = element("put-mode").value === "height";
    element("height-row").hidden = !chosen;
    viewer.height = chosen ? Number(height.value) : null;
    element("height-label").textContent = `${Number(height.value).toFixed(2)} m`;
  };
  element("put-mode").addEventListener("change", set);
  height.addEventListener("input", set);
  set();
}

function connectSources(viewer) {
  const { sources } = viewer.page.scene;
  element("sources").hidden = !sources.length;
  for (const name of sources) {
    const row = document.createElement("div");
    row.className = "row";
    const id = `source-${name}`;
    const label = Object.assign(document.createElement("label"), { textContent: name, htmlFor: id, title: name });
    const slider = Object.assign(document.createElement("input"), { type: "range", id, min: 0, max: MOST_LEFT, step: 0.01, value: 0 });
    const output = document.createElement("output");
    row.append(label, slider, output);
    element("source-list").append(row);
    slider.addEventListener("input", () => {
      const left = Number(slider.value);
      if (left) viewer.lights.existing[name] = [left, left, left];
      else delete viewer.lights.existing[name];
      viewer.change("lights");
    });
    viewer.addEventListener("change", () => {
      const kept = viewer.lights.existing[name] ?? [0, 0, 0];
      const mean = (kept[0] + kept[1] + kept[2]) / 3;
      if (document.activeElement !== slider) slider.value = mean;
      output.textContent = mean ? `${Math.round(100 * mean)} %` : "off";
    });
  }
}

function connectPicture(viewer) {
  const exposure = element("exposure");
  exposure.value = viewer.stops;
  const show = () => {
    const { stops } = viewer;
    element("exposure-label").textContent = `${stops > 0 ? "+" : ""}${stops.toFixed(1)} EV`;
  };
  exposure.addEventListener("input", () => {
    viewer.stops = Number(exposure.value);
    viewer.change("display");
  });
  viewer.addEventListener("change", show);
  element("reset").addEventListener("click", () => {
    viewer.lights.reset(viewer.page.setup);
    viewer.stops = Number((exposure.value = 0));
    viewer.selected = null;
    viewer.change("lights", "display");
  });
}

function connectSpeed(viewer) {
  let shown = 0;
  viewer.addEventListener("rendered", () => {
    if (performance.now() - shown < 300) return;
    shown = performance.now();
    const { passes, adapter, precision, fps, milliseconds } = viewer.stats();
    element("fps").textContent = `${milliseconds.toFixed(milliseconds < 10 ? 1 : 0)} ms, ${fps.toFixed(fps < 10 ? 1 : 0)} fps`;
    element("adapter").textContent = `${adapter}, pictures in ${precision === "f16" ? "half" : "single"} precision`;
    const rows = Object.entries(passes).map(([label, time]) => {
      const row = document.createElement("tr");
      row.insertCell().textContent = label;
      row.insertCell().textContent = `${time.toFixed(time < 10 ? 2 : 0)} ms`;
      return row;
    });
    element("times").tBodies[0].replaceChildren(...rows);
  });
}

function connectNotices(viewer) {
  const notice = element("notice");
  let timer = 0;
  viewer.addEventListener("notice", ({ detail }) => {
    notice.textContent = detail;
    notice.hidden = false;
    clearTimeout(timer);
    timer = setTimeout(() => { notice.hidden = true; }, 1e3 * NOTICE_SECONDS);
  });
}
