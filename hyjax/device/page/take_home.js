// What visitors take home: the lights, the picture, and a video of all frames, made by the browser itself.
import { Display } from "./display.js";

const RATE = 12; // frames a second of a video
const BITS = 8e6; // a second of a video, at most
const KINDS = ["video/mp4", "video/webm"];
const KEPT = 1e4; // milliseconds

/** Hand a file to the visitor. */
export function handOver(content, name) {
  const url = URL.createObjectURL(content);
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), KEPT);
}

/** Buttons of a page without a server. */
export function connectTakeHome(viewer) {
  const onClick = (id, work) => {
    const button = document.getElementById(id);
    button.addEventListener("click", async () => {
      button.disabled = true;
      await Promise.resolve().then(work).catch((error) => viewer.say(error.message));
      button.disabled = false;
    });
  };
  onClick("save", () => {
    const content = viewer.lights.content();
    if (!content.lights.length) throw new Error("All lights are off; a lights file needs one.");
    handOver(new Blob([`${JSON.stringify(content, null, 2)}\n`], { type: "application/json" }), "lights.json");
  });
  onClick("save-picture", async () => {
    const { canvas, draw } = await copyOf(viewer);
    await draw();
    canvas.toBlob((picture) => handOver(picture, `relit-${viewer.frame + 1}.png`));
  });
  onClick("save-video", () => recordVideo(viewer));
}

/** A canvas of its own, and a function that draws on it what the viewer shows, without the wipe. */
async function copyOf(viewer) {
  const canvas = document.createElement("canvas");
  const display = await Display.create(viewer.device, canvas, viewer.page, true);
  const draw = async () => {
    await viewer.drawn(true);
    const { stage, stops, renderer } = viewer;
    await display.draw(renderer.engine, { stage, wipe: 0, stops, lights: renderer.lights });
  };
  return { canvas, draw, context: display.context };
}

/** Draw all frames, then play them to the browser's recorder: it takes the time that passes for the video's. */
async function recordVideo(viewer) {
  const kind = KINDS.find((type) => globalThis.MediaRecorder?.isTypeSupported(type));
  if (!kind) throw new Error("This browser cannot record videos.");
  const { frame, flying, frames } = viewer;
  const { canvas, draw, context } = await copyOf(viewer);
  const pictures = [];
  viewer.playing = false;
  try {
    for (let k = 0; k < frames.count; k++) {
      viewer.say(`Video: frame ${k + 1} of ${frames.count}.`);
      viewer.goTo(k);
      await draw();
      pictures.push(await createImageBitmap(canvas));
    }
  } finally {
    Object.assign(viewer, { frame, flying });
    viewer.change("camera");
  }
  const stream = canvas.captureStream(0);
  const [track] = stream.getVideoTracks();
  const asked = track.requestFrame ? track : stream; // Firefox asks the stream
  const recorder = new MediaRecorder(stream, { mimeType: kind, videoBitsPerSecond: BITS });
  const parts = [];
  recorder.addEventListener("dataavailable", ({ data }) => parts.push(data));
  const stopped = new Promise((done) => { recorder.addEventListener("stop", done); });
  recorder.start();
  for (const picture of pictures) {
    context.drawImage(picture, 0, 0);
    picture.close();
    asked.requestFrame();
    await new Promise((done) => { setTimeout(done, 1e3 / RATE); });
  }
  recorder.stop();
  await stopped;
  handOver(new Blob(parts, { type: kind }), `relit.${kind.split("/")[1]}`);
}
