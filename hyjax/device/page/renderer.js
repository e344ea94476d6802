// Renderer: what to upload and which stages to run when lights, frame or camera change; the twin of renderer.py.
import { Engine } from "./engine.js";
import { darkness, luminance } from "./lights.js";
import {
  ambientFilter, emitterVectors, frameRecord, keptVectors, lightRecords, mapSize, movedLights, sizeMap,
} from "./records.js";
import { raised } from "./scene.js";

const BATCH_TEXELS = 1 << 20; // of shadow maps in one go, so that no launch takes seconds on a slow GPU
const REFINED_TEXELS = 1 << 22; // of shadow maps between two pictures, where there is more than one
const MOST_MAP_BYTES = 1 << 27; // of all shadow maps
const NOWHERE = { right: [1, 0, 0], down: [0, 1, 0], forward: [0, 0, 1], origin: [0, 0, 0], intrinsics: [1, 1, 0, 0] };

export class Renderer {
  /**
   * @param device from openDevice
   * @param page content of page.json
   * @param arrays from loadArrays
   */
  static async create(device, page, arrays) {
    device.pushErrorScope("out-of-memory");
    const engine = await Engine.create(device, page.program, 4, { depths: 16 });
    const lit = raised(arrays, page.scene.sources.length, page.exponent);
    for (const [name, values] of Object.entries(lit)) engine.upload(name, values);
    await checkMemory(device, page.size);
    return new Renderer(engine, page);
  }

  constructor(engine, page) {
    Object.assign(this, { engine, page, records: null, lights: [], setup: null, camera: NOWHERE, albedo: false });
    this.pending = new Set(["load"]);
    this.coarse = new Set(); // numbers of lights whose shadow maps are not of full size yet
    this.stale = new Set(); // numbers of lights whose shadow maps have to be cast
    this.times = {}; // milliseconds by label
  }

  /** Whether something is to be drawn. */
  get busy() {
    return this.pending.size > 0;
  }

  /**
   * Take lights. Shadow maps of those that have moved are coarse until `refine`.
   * @param setup from parseSetup
   * @returns whether any has moved
   */
  async setLights(setup) {
    const { scene } = this.page;
    const lights = setup.lights.length ? setup.lights : [darkness()];
    const { device } = this.engine;
    let { resolutions } = this.page;
    let records = lightRecords(lights, scene, resolutions);
    const most = Math.min(MOST_MAP_BYTES, device.limits.maxStorageBufferBindingSize) / 4;
    while (records.texels > most) {
      resolutions = resolutions.map((size) => size >> 1);
      records = lightRecords(lights, scene, resolutions);
    }
    device.pushErrorScope("out-of-memory");
    const made = this.engine.resize(lights.length, { depths: Math.max(16, 4 * records.texels) });
    const memory = checkMemory(device, this.page.size);
    if (made.includes("depths")) this.records = null; // all maps are gone
    if (made.length) this.pending.add("photo");
    const moved = movedLights(records, this.records);
    const kept = (numbers) => [...(this.records ? numbers : [])].filter((number) => records.jobs[number]?.length);
    this.coarse = new Set([...kept(this.coarse), ...moved]);
    this.stale = new Set([...kept(this.stale), ...moved]); // maps that have not been cast yet count, too
    for (const number of this.coarse) sizeMap(records, number, Math.max(8, records.sizes[number] >> 2));
    Object.assign(this, { records, lights, setup });
    this.engine.upload("lights", records.words);
    this.engine.upload("views", new Float32Array(records.views));
    this.engine.upload("kept", keptVectors(setup.existing, scene, lights, setup.reference_lux));
    this.engine.upload("emitters", emitterVectors(lights, setup.reference_lux, setup.existing, scene));
    this.pending.add("shadows").add("bounces").add("frame");
    await memory;
    return moved.length > 0;
  }

  /** Have some of the coarse shadow maps cast in full. */
  refine() {
    const { records } = this;
    let texels = 0;
    for (const number of this.coarse) {
      const own = records.jobs[number].length * records.sizes[number] ** 2;
      if (texels && texels + own > REFINED_TEXELS) break;
      texels += own;
      this.coarse.delete(number);
      this.stale.add(number);
      sizeMap(records, number, records.sizes[number]);
    }
    this.engine.upload("lights", records.words);
    this.pending.add("shadows").add("bounces").add("frame");
  }

  /**
   * Take a camera.
   * @param bitmap picture of the frame; null for a free camera, which sees the mesh's own colours
   */
  setCamera(camera, bitmap) {
    this.camera = camera;
    this.albedo = !bitmap;
    if (bitmap) {
      this.engine.uploadPhoto(bitmap);
      this.pending.add("photo");
    }
    this.pending.add("frame");
  }

  /** Run the stages that changed. With `timed`, `times` is brought up to date. */
  async run({ timed = false } = {}) {
    const { engine, page, lights, setup } = this;
    const { scene } = page;
    engine.upload("frame", frameRecord(this.camera, {
      counts: [lights.length, scene.panes.length, scene.lamps.length],
      albedo: this.albedo,
      ambient: ambientFilter(lights, setup.reference_lux),
      reference: setup.reference_lux,
      mean: scene.mean,
    }));
    const stages = ["load", "bounces", "photo", "frame"].filter((stage) => this.pending.has(stage));
    const batches = this.pending.has("shadows") ? this.mapBatches() : [];
    this.pending.clear();
    this.stale.clear();
    if (stages[0] === "load") engine.run([stages.shift()]);
    const last = batches.pop();
    for (const { jobs, side } of batches) {
      const begun = performance.now();
      engine.upload("jobs", new Uint32Array(jobs.flat()));
      engine.run(["shadows"], { jobs: jobs.length, side });
      await engine.device.queue.onSubmittedWorkDone();
      this.times["shadow maps"] = performance.now() - begun;
    }
    if (last) {
      engine.upload("jobs", new Uint32Array(last.jobs.flat()));
      stages.unshift("shadows");
    }
    if (this.albedo) stages.splice(0, stages.length, ...stages.filter((stage) => stage !== "photo"));
    engine.run(stages, { jobs: last?.jobs.length, side: last?.side, timed });
  }

  /** Views of the shadow maps to be cast, those of a size together, in batches. */
  mapBatches() {
    const batches = [];
    const bySize = [...this.stale].sort((a, b) => mapSize(this.records, a) - mapSize(this.records, b));
    for (const number of bySize) {
      const side = mapSize(this.records, number) + 2;
      const most = Math.max(1, Math.floor(BATCH_TEXELS / side ** 2));
      for (const job of this.records.jobs[number]) {
        if (batches.at(-1)?.side !== side || batches.at(-1).jobs.length >= most) batches.push({ side, jobs: [] });
        batches.at(-1).jobs.push(job);
      }
    }
    return batches;
  }

  /** Take over the GPU's times of the last timed run. */
  async readTimes() {
    Object.assign(this.times, (await this.engine.times()) ?? {});
  }

  /** Normal and depth of the surface at a pixel; null where there is none. */
  async surfaceAt(column, row) {
    const offset = 16 * (row * this.page.size[1] + column);
    const [x, y, z, depth] = await this.engine.download("surface", { offset, bytes: 16 });
    return depth > 0 ? { normal: [x, y, z], depth } : null;
  }

  /** Of each light: its share of the light in the picture without shadows, and the share of that which shadows leave. */
  async reach() {
    const groups = Math.ceil(this.lights.length / 4);
    const visible = this.page.program.names["visible totals"];
    const first = visible === "cascade totals" ? 2 + groups : 0;
    const [totals, seen] = await Promise.all(["cascade totals", visible].map((name) => this.engine.download(name)));
    const of = (values, first, k) => values[4 * first + k];
    const sums = this.lights.map((light, k) => of(totals, 2, k) * luminance(light.color));
    const all = sums.reduce((sum, value) => sum + value, luminance(totals));
    return {
      light: this.lights.map((light, k) => ({
        strength: light.strength,
        share: all > 0 ? sums[k] / all : 1,
        visible: of(seen, first, k) / Math.max(of(seen, first + groups, k), 1e-9),
      })),
    };
  }

  /** Linear RGB of the picture, row by row. */
  async pixels() {
    const image = await this.engine.download(this.page.program.names.image);
    const [height, width] = this.page.size;
    const result = new Float32Array(3 * height * width);
    for (let k = 0; k < height * width; k++) result.set(image.subarray(4 * k, 4 * k + 3), 3 * k);
    return result;
  }
}

/** Throws if the buffers made since `pushErrorScope` did not fit into memory. */
async function checkMemory(device, [height, width]) {
  if (!(await device.popErrorScope())) return;
  throw new Error(`The graphics memory is too small for this page's ${width} x ${height} pixels: export it with a smaller --size.`);
}
