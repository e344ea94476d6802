// Engine that runs a program (hyjax/device/program.py) on the browser's GPU; the twin of hyjax/device/webgpu.py.

export const FORMAT = 1;
const SOFTWARE = /swiftshader|llvmpipe|basic render/i; // names of adapters, where the browser does not say

/** A device of the best adapter. Throws an Error whose message says what is missing. */
export async function openDevice() {
  if (!globalThis.isSecureContext) {
    throw new Error("WebGPU needs https, or an address on this machine such as http://localhost.");
  }
  if (!navigator.gpu) {
    throw new Error("This browser has no WebGPU. Chrome 121, Edge 121, Safari 26 and Firefox 141 have it.");
  }
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  if (!adapter) throw new Error("This browser has WebGPU but found no graphics adapter for it: its driver may be blocked, or hardware acceleration be off.");
  const wanted = ["timestamp-query", "shader-f16"].filter((name) => adapter.features.has(name));
  const limits = {};
  for (const name of ["maxStorageBufferBindingSize", "maxBufferSize"]) {
    limits[name] = adapter.limits[name];
  }
  const device = await adapter.requestDevice({ requiredFeatures: wanted, requiredLimits: limits });
  device.hyjaxName = adapterName(adapter);
  const told = adapter.info?.isFallbackAdapter ?? adapter.isFallbackAdapter;
  device.isSoftware = told ?? SOFTWARE.test(device.hyjaxName);
  return device;
}

function adapterName(adapter) {
  const info = adapter.info ?? {};
  return [info.vendor, info.architecture, info.device, info.description].filter(Boolean).join(" ") || "unknown adapter";
}

/** Number of channel groups: base + lights * G, with G groups of four lights. */
const groupCount = (groups, lights) => groups.base + groups.lights * Math.ceil(lights / 4);

export class Engine {
  /**
   * @param device from openDevice
   * @param program plain data
   * @param lights number of lights
   * @param sizes bytes of buffers that the program leaves open
   * @param pipelines compiled shaders by name, which programs of one device may share; new ones are added
   */
  static async create(device, program, lights, sizes = {}, pipelines = {}) {
    if (program.format !== FORMAT) throw new Error(`program of format ${program.format}; this script reads ${FORMAT}`);
    const engine = new Engine(device, program, lights, sizes);
    engine.pipelines = pipelines;
    await engine.compile();
    return engine;
  }

  constructor(device, program, lights, sizes) {
    Object.assign(this, { device, program, lights: 0 });
    this.buffers = {};
    this.bound = new Map();
    this.resize(lights, sizes);
    const [height, width] = program.size;
    const use = GPUTextureUsage;
    const texture = (format, usage) => device.createTexture({ size: [width, height], format, usage });
    this.textures = {
      shown: texture("r32uint", use.RENDER_ATTACHMENT | use.TEXTURE_BINDING),
      photo: texture("rgba8unorm", use.COPY_DST | use.TEXTURE_BINDING | use.RENDER_ATTACHMENT),
      depth: texture("depth32float", use.RENDER_ATTACHMENT),
    };
    this.pipelines = {};
    this.timer = device.features.has("timestamp-query") ? new Timer(device) : null;
  }

  /**
   * Take another number of lights. Buffers that are large enough stay as they are, with what they hold.
   * Returns the names of those that were made anew.
   */
  resize(lights, sizes = {}) {
    const made = [];
    const fit = (name, bytes, buffer) => {
      const size = Math.max(16, Math.ceil(bytes / 16) * 16);
      if (this.buffers[name]?.size >= size) return;
      const { maxBufferSize, maxStorageBufferBindingSize } = this.device.limits;
      const most = Math.min(maxBufferSize, maxStorageBufferBindingSize);
      if (size > most) {
        throw new Error(`This GPU takes buffers of ${most >> 20} MiB at most, "${name}" needs ${Math.ceil(size / 2 ** 20)}: `
          + "export the page with a smaller --size, or use fewer lights.");
      }
      this.buffers[name]?.destroy();
      this.makeBuffer(name, size, buffer);
      made.push(name);
    };
    for (const [name, buffer] of Object.entries(this.program.buffers)) {
      fit(name, buffer.bytes * groupCount(buffer.groups, lights), buffer);
    }
    for (const [name, bytes] of Object.entries(sizes)) fit(name, bytes, null);
    if (made.length) this.bound.clear();
    this.lights = lights;
    return made;
  }

  makeBuffer(name, size, buffer) {
    const use = GPUBufferUsage;
    const usage = use.COPY_DST | use.COPY_SRC | use.STORAGE | (buffer?.uniform ? use.UNIFORM : 0);
    this.buffers[name] = this.device.createBuffer({ size, usage, label: name });
    if (buffer?.initial.length) this.upload(name, new Uint32Array(buffer.initial));
  }

  async compile() {
    const shaders = Object.entries(this.program.shaders).filter(([name]) => !(name in this.pipelines));
    await Promise.all(shaders.map(async ([name, code]) => {
      const module = this.device.createShaderModule({ code, label: name });
      this.pipelines[name] = name.startsWith("raster-")
        ? await this.device.createRenderPipelineAsync({
            layout: "auto",
            vertex: { module, entryPoint: "vertex" },
            fragment: { module, entryPoint: "fragment", targets: [{ format: "r32uint" }] },
            primitive: { topology: "triangle-list", cullMode: "none" },
            depthStencil: { format: "depth32float", depthWriteEnabled: true, depthCompare: "greater" },
          })
        : await this.device.createComputePipelineAsync({ layout: "auto", compute: { module, entryPoint: "main" } });
    }));
  }

  /** Fill a buffer from its beginning, or from a byte offset. */
  upload(name, values, offset = 0) {
    if (values.byteLength) this.device.queue.writeBuffer(this.buffers[name], offset, values);
  }

  /** Fill the texture `photo` from an ImageBitmap of the program's size. */
  uploadPhoto(bitmap) {
    const [height, width] = this.program.size;
    this.device.queue.copyExternalImageToTexture({ source: bitmap }, { texture: this.textures.photo }, [width, height]);
  }

  /** Content of a buffer, or `bytes` of it from an offset. */
  async download(name, { Type = Float32Array, offset = 0, bytes = this.buffers[name].size } = {}) {
    const copy = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(this.buffers[name], offset, copy, 0, bytes);
    this.device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const values = new Type(copy.getMappedRange().slice(0));
    copy.destroy();
    return values;
  }

  /**
   * Encode the launches of stages.
   * @param options jobs: views of shadow maps, for the stage `shadows`; side: texels a side of each, with the gutter;
   *   timed: whether the GPU's time of each label can be read with `times`
   */
  encode(encoder, stages, { jobs = 0, side = 0, timed = false } = {}) {
    const timer = timed ? this.timer : null;
    timer?.begin();
    for (const stage of stages) {
      for (const launch of this.program.launches) {
        if (launch.stage !== stage) continue;
        if (launch.shader.startsWith("raster-")) this.encodeRaster(encoder, launch, timer);
        else this.encodeLaunch(encoder, launch, jobs, side, timer);
      }
    }
    timer?.end(encoder);
  }

  /** Run stages; see `encode`. */
  run(stages, options) {
    const encoder = this.device.createCommandEncoder();
    this.encode(encoder, stages, options);
    this.device.queue.submit([encoder.finish()]);
  }

  /** Milliseconds of each label of the last timed run; null without timestamps. */
  async times() {
    return this.timer ? this.timer.read() : null;
  }

  encodeLaunch(encoder, launch, jobs, side, timer) {
    const depth = launch.jobs ? jobs : groupCount(launch.depth, this.lights);
    if (!depth) return;
    const pass = encoder.beginComputePass({ timestampWrites: timer?.writes(launch.label) });
    pass.setPipeline(this.pipelines[launch.shader]);
    pass.setBindGroup(0, this.bind(launch));
    const [width, height] = launch.jobs ? [Math.ceil(side / 8), Math.ceil(side / 8)] : [launch.width, launch.height];
    pass.dispatchWorkgroups(width, height, depth);
    pass.end();
  }

  encodeRaster(encoder, launch, timer) {
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: this.textures.shown.createView(), loadOp: "clear", storeOp: "store", clearValue: [0, 0, 0, 0] }],
      depthStencilAttachment: {
        view: this.textures.depth.createView(), depthLoadOp: "clear", depthStoreOp: "store", depthClearValue: 0,
      },
      timestampWrites: timer?.writes(launch.label),
    });
    pass.setPipeline(this.pipelines[launch.shader]);
    pass.setBindGroup(0, this.bind(launch));
    pass.draw(launch.width);
    pass.end();
  }

  bind(launch) {
    if (!this.bound.has(launch)) {
      const entries = launch.bind.map((name, binding) => ({
        binding,
        resource: name in this.textures ? this.textures[name].createView() : { buffer: this.buffers[name] },
      }));
      const layout = this.pipelines[launch.shader].getBindGroupLayout(0);
      this.bound.set(launch, this.device.createBindGroup({ layout, entries }));
    }
    return this.bound.get(launch);
  }

  destroy() {
    for (const buffer of Object.values(this.buffers)) buffer.destroy();
    for (const texture of Object.values(this.textures)) texture.destroy();
    this.timer?.destroy();
  }
}

/** Times of passes by timestamps, added up by label. */
class Timer {
  static MOST = 512; // passes

  constructor(device) {
    this.device = device;
    this.set = device.createQuerySet({ type: "timestamp", count: 2 * Timer.MOST });
    this.resolved = device.createBuffer({ size: 16 * Timer.MOST, usage: GPUBufferUsage.QUERY_RESOLVE | GPUBufferUsage.COPY_SRC });
    this.labels = [];
  }

  begin() {
    this.labels = [];
  }

  writes(label) {
    if (this.labels.length >= Timer.MOST) return undefined;
    this.labels.push(label);
    const k = 2 * (this.labels.length - 1);
    return { querySet: this.set, beginningOfPassWriteIndex: k, endOfPassWriteIndex: k + 1 };
  }

  end(encoder) {
    if (this.labels.length) encoder.resolveQuerySet(this.set, 0, 2 * this.labels.length, this.resolved, 0);
  }

  async read() {
    const copy = this.device.createBuffer({ size: this.resolved.size, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(this.resolved, 0, copy, 0, this.resolved.size);
    this.device.queue.submit([encoder.finish()]);
    const labels = [...this.labels];
    await copy.mapAsync(GPUMapMode.READ);
    const ticks = new BigUint64Array(copy.getMappedRange().slice(0));
    copy.destroy();
    const times = {};
    labels.forEach((label, k) => {
      times[label] = (times[label] ?? 0) + Number(ticks[2 * k + 1] - ticks[2 * k]) / 1e6;
    });
    return times;
  }

  destroy() {
    this.set.destroy();
    this.resolved.destroy();
  }
}
