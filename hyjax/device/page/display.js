// The canvas: a stage of the frame, drawn by wgsl/display.wgsl.
export const STAGES = ["result", "photo", "normals", "depth", "raw filter", "refined filter", "visibility"];
const MOST_LIGHTS = 32;
const MOST_LIGHT = 4.2; // linear value that displays of high dynamic range show four times as bright as white

export class Display {
  /**
   * @param device from openDevice
   * @param canvas that is drawn to
   * @param page content of page.json
   * @param copied whether pictures are copied to the canvas by way of the CPU: GPUs made of software, and some
   *   drivers, cannot share a canvas with the browser and lose the device over it
   */
  static async create(device, canvas, page, copied = false) {
    const display = new Display(device, canvas, page, copied);
    const module = device.createShaderModule({ code: page.display, label: "display" });
    display.pipeline = await device.createRenderPipelineAsync({
      layout: "auto",
      vertex: { module, entryPoint: "vertex" },
      fragment: {
        module, entryPoint: "fragment", targets: [{ format: display.format }],
        constants: display.format === "rgba16float" ? { most_light: MOST_LIGHT } : {},
      },
    });
    return display;
  }

  constructor(device, canvas, page, copied) {
    this.device = device;
    this.names = page.program.names;
    const [height, width] = page.size;
    Object.assign(canvas, { width, height });
    Object.assign(this, { width, height, format: "rgba8unorm", target: null });
    if (copied) {
      this.context = canvas.getContext("2d");
      this.target = device.createTexture({
        size: [width, height], format: this.format, usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC,
      });
    } else {
      const high = matchMedia("(dynamic-range: high)").matches;
      this.format = high ? "rgba16float" : navigator.gpu.getPreferredCanvasFormat();
      this.context = canvas.getContext("webgpu");
      if (!this.context) throw new Error("The browser gave the page no WebGPU canvas.");
      const configure = (mode) => this.context.configure({ device, format: this.format, alphaMode: "opaque", toneMapping: { mode } });
      configure(high ? "extended" : "standard");
      if (high && this.context.getConfiguration?.().toneMapping?.mode !== "extended") { // the browser has none
        this.format = navigator.gpu.getPreferredCanvasFormat();
        configure("standard");
      }
    }
    const uniform = (size) => device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.shown = uniform(16);
    this.colors = uniform(16 * MOST_LIGHTS);
  }

  /**
   * Draw a stage.
   * @param engine whose buffers hold the frame
   * @param options stage: one of STAGES; wipe: share of the width that shows the photo; stops: of exposure; lights
   */
  async draw(engine, { stage, wipe, stops, lights }) {
    const { queue } = this.device;
    const words = new Float32Array([0, 0, wipe * this.width, 2 ** stops]);
    new Uint32Array(words.buffer).set([Math.max(0, STAGES.indexOf(stage)), lights.length]);
    queue.writeBuffer(this.shown, 0, words);
    queue.writeBuffer(this.colors, 0, new Float32Array(lights.flatMap((light) => [...light.color, 0])));
    const { raw, refined, visibility, image } = this.names;
    const buffers = [image, "picture", "surface", stage === "raw filter" ? raw : refined, "cascade totals", visibility];
    const entries = [this.shown, ...buffers.map((name) => engine.buffers[name]), this.colors]
      .map((buffer, binding) => ({ binding, resource: { buffer } }));
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: (this.target ?? this.context.getCurrentTexture()).createView(), loadOp: "clear", storeOp: "store" }],
    });
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.device.createBindGroup({ layout: this.pipeline.getBindGroupLayout(0), entries }));
    pass.draw(3);
    pass.end();
    queue.submit([encoder.finish()]);
    if (this.target) await this.copy();
  }

  /** Copy the picture that was drawn to the canvas. */
  async copy() {
    const { device, width, height } = this;
    const bytesPerRow = 256 * Math.ceil((4 * width) / 256);
    const buffer = device.createBuffer({ size: bytesPerRow * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = device.createCommandEncoder();
    encoder.copyTextureToBuffer({ texture: this.target }, { buffer, bytesPerRow }, [width, height]);
    device.queue.submit([encoder.finish()]);
    await buffer.mapAsync(GPUMapMode.READ);
    const rows = new Uint8ClampedArray(buffer.getMappedRange());
    const picture = new ImageData(width, height);
    for (let y = 0; y < height; y++) picture.data.set(rows.subarray(y * bytesPerRow, y * bytesPerRow + 4 * width), 4 * width * y);
    buffer.destroy();
    this.context.putImageData(picture, 0, 0);
  }
}
