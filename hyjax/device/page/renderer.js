// Renderer: what to upload and which stages to run when lights, frame or camera change; the twin of renderer.py.
import { Engine } from "./engine.js";
import { darkness } from "./lights.js";
import {
  ambientFilter, emitterVectors, frameRecord, keptVectors, lightRecords, movedLights,
} from "./records.js";

const MOST_JOBS = 16; // views of shadow maps in one go, so that no launch takes seconds on a slow GPU
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
    for (const [name, values] of Object.entries(arrays)) engine.upload(name, values);
    await checkMemory(device, page.size);
    return new Renderer(engine, page);
  }

  constructor(engine, page) {
    Object.assign(this, { engine, page, records: null, lights: [], setup: null, camera: NOWHERE, albedo: false });
    this.pending = new Set(["load"]);
    this.jobs = [];
    this.times = {}; // milliseconds by label
  }

  /** Whether something is to be drawn. */
  get busy() {
    return this.pending.size > 0;
  }

  /**
   * Take lights.
   * @param setup from parseSetup
   * @param coarse numbers of lights whose shadow maps may be coarse
   */
  async setLights(setup, coarse = new Set()) {
    const { scene, resolutions } = this.page;
    const lights = setup.lights.length ? setup.lights : [darkness()];
    const records = lightRecords(lights, scene, resolutions, coarse);
    const { device } = this.engine;
    device.pushErrorScope("out-of-memory");
    const made = this.engine.resize(lights.length, { depths: Math.max(16, 4 * records.texels) });
    const memory = checkMemory(device, this.page.size);
    if (made.includes("depths")) this.records = null; // all maps are gone
    if (made.length) this.pending.add("photo");
    const moved = movedLights(records, this.records);
    // Jobs that have not run yet count, too: their lights may not have moved since.
    const numbers = new Set([...moved, ...(this.records ? this.jobs.map(([light]) => light) : [])]);
    this.jobs = [...numbers].flatMap((number) => records.jobs[number] ?? []);
    Object.assign(this, { records, lights, setup });
    this.engine.upload("lights", records.words);
    this.engine.upload("kept", keptVectors(setup.existing, scene, lights, setup.reference_lux));
    this.engine.upload("emitters", emitterVectors(lights, setup.reference_lux, setup.existing, scene));
    if (this.jobs.length) this.pending.add("shadows");
    this.pending.add("bounces").add("frame");
    await memory;
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
    let jobs = this.pending.has("shadows") ? this.jobs : [];
    this.pending.clear();
    this.jobs = [];
    if (stages[0] === "load") engine.run([stages.shift()]);
    while (jobs.length > MOST_JOBS) {
      const begun = performance.now();
      this.cast(jobs.slice(0, MOST_JOBS));
      await engine.device.queue.onSubmittedWorkDone();
      this.times["shadow maps"] = performance.now() - begun;
      jobs = jobs.slice(MOST_JOBS);
    }
    if (jobs.length) {
      engine.upload("jobs", new Uint32Array(jobs.flat()));
      stages.unshift("shadows");
    }
    if (this.albedo) stages.splice(0, stages.length, ...stages.filter((stage) => stage !== "photo"));
    engine.run(stages, { jobs: jobs.length, timed });
  }

  cast(jobs) {
    this.engine.upload("jobs", new Uint32Array(jobs.flat()));
    this.engine.run(["shadows"], { jobs: jobs.length });
  }

  /** Take over the GPU's times of the last timed run. */
  async readTimes() {
    Object.assign(this.times, (await this.engine.times()) ?? {});
  }

  /** Position and normal of the surface at each pixel, four numbers each; the fourth are depth and whether there is any. */
  async surface() {
    const [positions, normals] = await Promise.all([this.engine.download("positions"), this.engine.download("normals")]);
    return { positions, normals };
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
