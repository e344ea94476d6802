// Start of the page: load, open the GPU, or say what is missing.
import { connectControls } from "./controls.js";
import { connectPointer } from "./pointer.js";
import { Frames, loadArrays, loadPage } from "./scene.js";
import { Viewer } from "./viewer.js";

const element = (id) => document.getElementById(id);

function showFailure(error) {
  console.error(error);
  document.body.dataset.state = "failed";
  element("failure-text").textContent = error.message;
}

function showProgress(share) {
  element("loading-bar").style.width = `${Math.round(100 * share)}%`;
}

function checkBrowser() {
  if (!globalThis.isSecureContext) {
    throw new Error("This page needs WebGPU, which browsers have on https pages only, or on http://localhost.");
  }
  if (!navigator.gpu) {
    throw new Error("This browser has no WebGPU. Chrome and Edge have it from version 121, Safari from 26, Firefox from 141 on.");
  }
}

async function start() {
  document.body.dataset.state = "loading";
  const page = await loadPage();
  if (!page.server) checkBrowser();
  document.title = `${page.name} – relit`;
  element("title").textContent = page.name;
  element("stage").style.setProperty("--aspect", page.size[1] / page.size[0]);
  const frames = new Frames(page);
  frames.picture(0).catch(() => {});
  const tour = page.server ? await import("./tour.js") : null;
  const arrays = tour ? null : await loadArrays(page, showProgress);
  element("loading-text").textContent = "Preparing the picture …";
  const viewer = new Viewer(page, arrays, frames, element("canvas"));
  viewer.addEventListener("failure", ({ detail }) => showFailure(detail));
  connectControls(viewer);
  connectPointer(viewer);
  await (tour ? tour.startTour(viewer, showProgress) : viewer.start());
  document.body.dataset.state = "ready";
  viewer.change("display");
  return viewer;
}

const started = start();
const ready = started.then(() => {});
ready.catch(showFailure);

/** For scripts and tests; see README.md. */
window.hyjax = {
  ready,
  get fps() {
    return viewer?.fps ?? 0;
  },
  plan: () => viewer?.lights.plan?.(viewer.stops) ?? null,
  stats: () => viewer?.stats() ?? null,
  async setLights(content) {
    const shown = await started;
    shown.lights.reset(content);
    shown.change("lights");
    await shown.drawn(true);
  },
  async goto(frame) {
    const shown = await started;
    shown.goTo(frame);
    await shown.drawn(true);
  },
  async pixels() {
    const shown = await started;
    await shown.drawn(true);
    return shown.usesServer ? shown.remote.pixels() : shown.renderer.pixels();
  },
};

let viewer = null;
started.then((found) => { viewer = found; }, () => {});
