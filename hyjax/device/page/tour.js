// Tour: a page with a server (hyjax/tour/), which draws what the visitor's GPU does not, and keeps the set-up.
import { Connection } from "./connection.js";
import { openDevice } from "./engine.js";
import { connectHandles } from "./handles.js";
import { RemoteEngine } from "./remote_engine.js";
import { loadArrays, loadJson } from "./scene.js";
import { connectTourPanels } from "./tour_panels.js";

const FLICKER = 170; // milliseconds
const KEEP_AFTER = 800; // milliseconds without a change after which the set-up is kept
const NO_ANSWER = "The server does not answer, or has too many visitors; trying again …";
const SHOWN = { result: "relit" }; // stages by the server's names

/** Connect a viewer to the server, choose who draws, and show the first picture. */
export async function startTour(viewer, showProgress) {
  const { page } = viewer;
  const { engine } = page.server;
  const address = new URL("socket", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  const connection = new Connection(address);
  viewer.connection = connection;
  viewer.state = () => state(viewer);
  const canvas = Object.assign(viewer.canvas.cloneNode(), { id: "remote", hidden: true }); // with its name
  viewer.canvas.after(canvas);
  viewer.remote = new RemoteEngine(connection, viewer.state, canvas, page, () => viewer.change("display"), (text) => viewer.say(text));
  connectTourPanels(viewer);
  connectHandles(viewer);
  const told = document.getElementById("loading-text");
  const { textContent: preparing } = told;
  connection.addEventListener("lost", () => { told.textContent = NO_ANSWER; });
  connection.addEventListener("open", () => { told.textContent = preparing; });
  await connection.opened;
  await followOutside(viewer);
  setInterval(() => flicker(viewer), FLICKER);
  connection.addEventListener("open", () => viewer.change("display"));
  if (engine !== "server" && await openGpu(viewer, engine === "visitor", showProgress)) {
    if (engine === "auto") viewer.fallBack = (error) => fallBack(viewer, error);
    await viewer.start().catch((error) => viewer.fail(error));
    if (viewer.renderer) return;
  } else {
    viewer.loop();
  }
  viewer.change("display");
  await viewer.drawn();
}

/** Let the server draw in the place of a GPU that failed. */
function fallBack(viewer, error) {
  console.info(error.message);
  viewer.say("This device's graphics failed; the server draws now.");
  const { device } = viewer;
  Object.assign(viewer, { fallBack: null, renderer: null, device: undefined, stopped: false });
  device?.destroy(); // there is none where it could not be opened again
  viewer.change("lights", "camera", "display");
  viewer.loop();
  return true;
}

/** Let candles flicker. */
function flicker(viewer) {
  const { lights } = viewer;
  const burning = lights.items.some(({ entry, on }) => entry.lamp === "candle" && on);
  const seconds = matchMedia("(prefers-reduced-motion)").matches ? 0 : performance.now() / 1e3;
  if (!burning || document.hidden || seconds === lights.seconds) return;
  lights.seconds = seconds;
  viewer.dirty[viewer.usesServer ? "display" : "flames"] = true;
}

/** All that the server draws from. */
function state(viewer) {
  const { lights, frame, flying, stage, stops } = viewer;
  const view = { frame, shown: SHOWN[stage] ?? stage, ...lights.refinement, seconds: lights.seconds };
  if (flying) {
    const { right, down, forward, origin } = flying.camera;
    view.camera = [right, down, forward, origin];
  }
  return { plan: lights.plan(stops), view };
}

/** Load what the visitor's GPU takes; whether it can draw. */
async function openGpu(viewer, must, showProgress) {
  const { page } = viewer;
  try {
    const device = await openDevice();
    device.destroy();
    if (device.isSoftware && !must) return false;
    Object.assign(page, await loadJson("gpu.json"));
    viewer.arrays = await loadArrays(page, showProgress);
    return true;
  } catch (error) {
    if (must) throw error;
    console.info(error.message);
    return false;
  }
}

/** Ask for the light from outside whenever what it depends on has changed; resolves when it is there at first. */
async function followOutside(viewer) {
  const { lights, connection } = viewer;
  let asked = "";
  let busy = false;
  const follow = async () => {
    if (busy || asked === lights.outsideKey || !connection.ready) return;
    busy = true;
    asked = lights.outsideKey;
    try {
      lights.outside = await connection.ask("daylight", viewer.state());
      viewer.change(...(viewer.usesServer ? [] : ["lights"]));
    } catch (error) {
      viewer.say(error.message);
    } finally {
      busy = false;
    }
    follow();
  };
  connection.addEventListener("lost", () => { asked = ""; }); // its answer will not come
  let keep = 0;
  let kept = JSON.stringify(lights.plan(viewer.stops));
  viewer.addEventListener("change", () => {
    follow();
    clearTimeout(keep);
    keep = setTimeout(() => {
      if (!connection.ready) return; // it is compared when the connection is open again
      const plan = JSON.stringify(lights.plan(viewer.stops));
      if (plan !== kept && !viewer.usesServer) connection.send("keep", viewer.state());
      kept = plan;
    }, KEEP_AFTER);
  });
  await follow();
}
