// Viewer: what is shown, and the loop that draws it when something has changed.
import { FlyingCamera, frameCamera, project, rayThrough } from "./camera.js";
import { LightList } from "./light_list.js";
import { openDevice } from "./engine.js";
import { Display, STAGES } from "./display.js";
import { moveEntry, placeAt } from "./placing.js";
import { choosePrecision } from "./precision.js";
import { whyUnseen } from "./reach.js";
import { Renderer } from "./renderer.js";
import { TourLights } from "./tour_lights.js";
import { Waiting } from "./waiting.js";

const REFINE_AFTER = 200; // milliseconds that lights lie still before their shadows are cast in full
const FILTERS = ["refined filter", "visibility"]; // stages that are interpolated to be shown
const IN_FLIGHT = 2; // pictures that the GPU is given before one is done
const LOST_WITHIN = 300; // milliseconds
const TIMED_EVERY = 500; // milliseconds
const LOST_AGAIN = 60e3; // milliseconds within which a third loss of the device is one too many

export class Viewer extends EventTarget {
  /**
   * @param page content of page.json
   * @param arrays from loadArrays
   * @param frames Frames
   * @param canvas that it draws to
   */
  constructor(page, arrays, frames, canvas) {
    super();
    Object.assign(this, { page, arrays, frames, canvas, stops: page.server?.plan.exposure ?? 0 });
    Object.assign(this, { frame: 0, flying: null, stage: "result", wipe: 0.5, playing: false, rate: 12 });
    this.lights = page.server ? new TourLights(page) : new LightList(page);
    this.remote = null; // RemoteEngine of a tour
    this.height = null; // metres above the floor at which lamps are put; null: off the surface
    this.keys = new Set();
    this.dirty = { lights: true, camera: true, display: true };
    this.fps = 0;
    this.milliseconds = 0;
    this.waiting = new Waiting();
    this.inFlight = []; // promises of pictures that are not done
    this.losses = []; // times of losses of the device
  }

  /** Open the GPU and draw the first picture. */
  async start() {
    const device = (this.device = await openDevice());
    device.addEventListener("uncapturederror", ({ error }) => this.say(`The graphics driver reports: ${error.message}`));
    device.lost.then(() => device === this.device && this.lost());
    await choosePrecision(this.page, device);
    this.renderer = await Renderer.create(this.device, this.page, this.arrays);
    if (this.display) { // a canvas keeps its first context
      const fresh = this.canvas.cloneNode();
      this.canvas.replaceWith(fresh);
      this.canvas = fresh;
    }
    const copied = this.device.isSoftware || this.losses.length > 1;
    this.display = await Display.create(this.device, this.canvas, this.page, copied);
    this.dirty = { lights: true, camera: true, display: true };
    this.stopped = false;
    this.loop();
    await this.drawn();
  }

  async lost() {
    this.stopped = true;
    const now = performance.now();
    this.losses = [...this.losses.filter((time) => now - time < LOST_AGAIN), now];
    if (this.losses.length > 2) {
      this.fail(new Error("The graphics device was lost three times within a minute. Reload the page to try again."));
      return;
    }
    this.say("The graphics device was lost; it is being opened again.");
    await this.start().catch((error) => this.fail(error));
  }

  /** Tell the visitor something. */
  say(text) {
    this.dispatchEvent(new CustomEvent("notice", { detail: text }));
  }

  fail(error) {
    this.stopped = true;
    if (this.fallBack?.(error)) return;
    this.failure = error;
    for (const { reject } of this.waiting.take(true)) reject(error);
    this.dispatchEvent(new CustomEvent("failure", { detail: error }));
  }

  /** What has changed: any of "lights", "camera", "display"; the flames of candles change by themselves. */
  change(...names) {
    for (const name of names) this.dirty[name] = true;
    this.dispatchEvent(new Event("change"));
  }

  /** Resolves when everything that has changed is drawn; with `rest`, when all shadows are, too. */
  drawn(rest = false) {
    return this.failure ? Promise.reject(this.failure) : this.waiting.promise(rest);
  }

  get isDirty() { return this.dirty.lights || this.dirty.camera || this.dirty.display; }
  async loop() {
    let last = performance.now();
    const { device } = this;
    while (!this.stopped && device === this.device) {
      const now = await new Promise(requestAnimationFrame);
      if (document.hidden) continue;
      const seconds = Math.min(0.1, Math.max(0, now - last) / 1e3);
      last = now;
      if (this.flying?.step(this.keys, seconds)) this.change("camera");
      if (this.playing && now - (this.turned ?? 0) >= 1e3 / this.rate) {
        this.turned = now;
        this.frame = (this.frame + 1) % this.frames.count;
        this.change("camera");
      }
      try {
        if (!this.dirty.lights && this.renderer?.coarse.size && now - this.moved >= REFINE_AFTER) {
          this.renderer.refine();
          this.dirty.display = true;
        }
        if (this.isDirty || this.dirty.flames) await this.draw(now);
      } catch (error) {
        // What fails because the device is lost is for `lost` to mend, which may hear of it a little later.
        await Promise.race([device?.lost, new Promise((done) => { setTimeout(done, LOST_WITHIN); })]);
        if (this.stopped || device !== this.device) return;
        this.fail(error);
        return;
      }
      if (this.isDirty) continue;
      const resting = this.usesServer ? !this.remote.draft : !this.renderer.coarse.size;
      if (resting && !this.usesServer && !this.reach && !this.playing && !this.flying) this.learnReach();
      const due = this.waiting.take(resting);
      if (due.length) await Promise.all(this.inFlight);
      for (const { resolve } of due) resolve();
    }
  }

  async draw(now) {
    if (this.usesServer) {
      await this.remote.show(this);
      return;
    }
    this.remote?.leave(this);
    const begun = performance.now();
    const dirty = this.dirty;
    this.dirty = { lights: false, camera: false, display: false };
    const { renderer } = this;
    if (dirty.camera) {
      const { camera, bitmap } = await this.seen();
      if (this.playing) this.frames.picture((this.frame + 1) % this.frames.count).catch(() => {});
      renderer.setCamera(camera, bitmap);
    }
    if (dirty.lights || dirty.camera) this.reach = null;
    if ((dirty.lights || dirty.flames) && (await renderer.setLights(this.lights.setup()))) this.moved = now;
    const timed = renderer.busy && now - (this.timed ?? -1e9) > TIMED_EVERY;
    const rendered = renderer.busy;
    if (rendered) await renderer.run({ timed });
    const { stage, wipe, stops } = this;
    if (FILTERS.includes(stage)) renderer.engine.run(["refined"]);
    await this.display.draw(renderer.engine, { stage, wipe: this.flying ? 0 : wipe, stops, lights: renderer.lights });
    if (timed) this.timed = now;
    const done = this.finish({ rendered, timed, begun }).catch(() => {}); // a lost device is for `lost`
    this.inFlight.push(done);
    done.then(() => { this.inFlight = this.inFlight.filter((other) => other !== done); });
    if (this.inFlight.length >= IN_FLIGHT) await this.inFlight[0];
  }

  /** Wait until the GPU is done with a picture. */
  async finish({ rendered, timed, begun }) {
    await this.device.queue.onSubmittedWorkDone();
    if (!rendered) return;
    this.milliseconds = performance.now() - begun;
    this.count(performance.now());
    if (timed) await this.renderer.readTimes();
    this.dispatchEvent(new Event("rendered"));
  }

  /** Whether the server of a tour makes the picture. */
  get usesServer() {
    return Boolean(this.remote) && (!this.renderer || this.lights.needsServer || !STAGES.includes(this.stage));
  }

  /** Find out which lights change something in the picture. */
  async learnReach() {
    const known = { light: [] };
    this.reach = known;
    const found = await this.renderer.reach().catch(() => null);
    if (!found || this.reach !== known) return;
    this.reach = found;
    this.dispatchEvent(new Event("change"));
  }

  whyUnseen(item) {
    const own = this.usesServer ? this.remote.reach?.[this.lights.items.indexOf(item)] : this.reach?.light[this.lights.numberOf(item.id)];
    return whyUnseen(item, own, this.page.scene.bounds);
  }

  /** The camera with its photo; none where it flies. A frame that cannot be read leaves the one before it. */
  async seen() {
    const { camera, flying, frame } = this;
    if (flying) return { camera, bitmap: null };
    try {
      const bitmap = await this.frames.picture(frame);
      this.lastFrame = frame;
      return { camera, bitmap };
    } catch (error) {
      if (this.lastFrame === undefined || this.lastFrame === frame) throw error;
      this.playing = false;
      this.frame = this.lastFrame;
      this.say(error.message);
      return this.seen();
    }
  }

  /** Frames a second, of pictures that come one after the other. */
  count(now) {
    const since = now - (this.counted ?? -1e9);
    this.counted = now;
    if (since < 1000) this.fps = this.fps ? 0.9 * this.fps + 100 / since : 1e3 / since;
    else this.fps = 1e3 / this.milliseconds;
  }

  // ---- camera ----

  get camera() {
    return this.flying ? this.flying.camera : frameCamera(this.page.frames[this.frame]);
  }

  goTo(frame) {
    if (!Number.isInteger(frame) || frame < 0 || frame >= this.frames.count) {
      throw new Error(`goto: the page has frames 0 to ${this.frames.count - 1}, got ${frame}.`);
    }
    this.flying = null;
    this.frame = frame;
    this.change("camera");
  }

  fly() {
    if (this.flying) return;
    this.playing = false;
    this.flying = new FlyingCamera(this.camera, this.page.scene.up, this.page.scene.bounds);
    this.change("camera");
  }

  land() {
    this.flying = null;
    this.change("camera");
  }

  // ---- lamps ----

  /** Where a lamp goes that is put at a pixel; null where there is no surface. */
  placeAt(x, y, item = null) {
    return placeAt(this, x, y, item);
  }

  async addLamp(x, y) {
    this.playing = false;
    const place = await this.placeAt(x, y);
    if (!place) throw new Error("There is no surface here; click on a wall, the floor or a piece of furniture.");
    const item = this.lights.add([...place], place.normal);
    this.selected = item.id;
    if (x <= this.wipe * this.page.size[1]) this.wipe = 0; // else it would light what the photo hides
    this.change("lights");
    return item;
  }

  /** Put a lamp somewhere. */
  moveLamp(item, position) {
    moveEntry(this.lights, item, position);
    this.change("lights");
  }

  /** Pixel of the picture at which a lamp is, and whether it is in view. */
  pixelOf(position) {
    const [height, width] = this.page.size;
    const at = project((this.usesServer && this.remote.camera) || this.camera, position);
    return at && at.x >= 0 && at.y >= 0 && at.x <= width && at.y <= height ? at : null;
  }

  ray(x, y) {
    return rayThrough(this.camera, x, y);
  }

  stats() {
    if (this.usesServer) return this.remote.stats(this);
    const { times } = this.renderer;
    const measured = Object.keys(times).length ? { ...times } : { "whole frame (wall clock)": this.milliseconds };
    return {
      adapter: this.device.hyjaxName,
      precision: this.page.program.precision,
      size: [...this.page.size],
      lights: this.renderer.lights.length,
      passes: measured,
      milliseconds: this.milliseconds,
      fps: this.fps,
    };
  }
}
