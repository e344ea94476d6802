// The canvas: a stage of the frame, drawn by wgsl/display.wgsl.
export const STAGES = ["result", "photo", "normals", "depth", "raw filter", "refined filter", "visibility"];
const MOST_LIGHTS = 32;

export class Display {
  static async create(device, canvas, page) {
    const display = new Display(device, canvas, page);
    const module = device.createShaderModule({ code: page.display, label: "display" });
    display.pipeline = await device.createRenderPipelineAsync({
      layout: "auto",
      vertex: { module, entryPoint: "vertex" },
      fragment: { module, entryPoint: "fragment", targets: [{ format: display.format }] },
    });
    return display;
  }

  constructor(device, canvas, page) {
    this.device = device;
    this.names = page.program.names;
    [canvas.height, canvas.width] = page.size;
    this.width = canvas.width;
    this.format = navigator.gpu.getPreferredCanvasFormat();
    this.context = canvas.getContext("webgpu");
    if (!this.context) throw new Error("The browser gave the page no WebGPU canvas.");
    this.context.configure({ device, format: this.format, alphaMode: "opaque" });
    const uniform = (size) => device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.shown = uniform(16);
    this.colors = uniform(16 * MOST_LIGHTS);
  }

  /**
   * Draw a stage.
   * @param engine whose buffers hold the frame
   * @param options stage: one of STAGES; wipe: share of the width that shows the photo; stops: of exposure; lights
   */
  draw(engine, { stage, wipe, stops, lights }) {
    const { queue } = this.device;
    const words = new Float32Array([0, 0, wipe * this.width, 2 ** stops]);
    new Uint32Array(words.buffer).set([Math.max(0, STAGES.indexOf(stage)), lights.length]);
    queue.writeBuffer(this.shown, 0, words);
    queue.writeBuffer(this.colors, 0, new Float32Array(lights.flatMap((light) => [...light.color, 0])));
    const { raw, refined, visibility, image } = this.names;
    const buffers = [image, "picture", "positions", "normals", stage === "raw filter" ? raw : refined, "cascade totals", visibility];
    const entries = [this.shown, ...buffers.map((name) => engine.buffers[name]), this.colors]
      .map((buffer, binding) => ({ binding, resource: { buffer } }));
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: this.context.getCurrentTexture().createView(), loadOp: "clear", storeOp: "store" }],
    });
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.device.createBindGroup({ layout: this.pipeline.getBindGroupLayout(0), entries }));
    pass.draw(3);
    pass.end();
    queue.submit([encoder.finish()]);
  }
}
