// Engine whose pictures the server of a tour makes: what renderer.js and display.js are for the visitor's own GPU.

const WAITING = 500; // milliseconds after which the page shows that it waits
const LATE = 180e3; // milliseconds after which a picture is given up: the first ones are compiled

/** Text of a state but for the time, by which candles flicker. */
const steady = ({ plan, view }) => JSON.stringify({ plan, view: { ...view, seconds: 0 } });

export class RemoteEngine {
  /**
   * @param connection Connection
   * @param state what a picture is asked for with: { plan, view }
   * @param canvas that pictures are drawn to
   * @param page content of page.json
   * @param changed called when a finer picture of the same state has come
   * @param say tells the visitor something
   */
  constructor(connection, state, canvas, page, changed, say) {
    Object.assign(this, { connection, state, canvas, page, changed, say });
    const [height, width] = page.size;
    Object.assign(canvas, { width, height });
    this.context = canvas.getContext("2d");
    this.asked = null; // text of the last state, and number of its message
    this.number = 0;
    this.bitmap = null;
    this.known = null; // reach of the lamps in the last picture, and the state that it is of
    this.steady = null;
    this.times = {};
    this.pixelsGiven = null;
    connection.addEventListener("picture", ({ detail }) => this.take(detail));
    connection.addEventListener("news", ({ detail }) => {
      if (detail.number === this.number && detail.refused) this.settle(new Error(detail.refused));
    });
    connection.addEventListener("lost", () => {
      this.asked = null;
      this.settle(new Error("The connection to the server was lost; trying again …"));
    });
  }

  /** Whether what is to be shown differs from what was asked for last. */
  get busy() {
    return this.asked !== JSON.stringify(this.state());
  }

  /** How far each lamp reaches in the picture; null unless it is of what is to be shown. */
  get reach() {
    return this.steady === steady(this.state()) ? this.known : null;
  }

  /** Ask for a picture, and wait for it. */
  async run() {
    const state = this.state();
    this.asked = JSON.stringify(state);
    const next = steady(state);
    if (next !== this.steady) this.known = null; // of other lamps, or where they were
    this.steady = next;
    await this.connection.opened;
    this.number = this.connection.send("picture", state);
    const waiting = setTimeout(() => this.canvas.parentElement.classList.add("waiting"), WAITING);
    await new Promise((resolve, reject) => {
      const late = setTimeout(() => this.settle(new Error("The server has not answered for three minutes.")), LATE);
      this.settle = (error) => {
        clearTimeout(late);
        clearTimeout(waiting);
        this.canvas.parentElement.classList.remove("waiting");
        this.settle = () => {};
        if (error) reject(error);
        else resolve();
      };
    });
  }

  settle() {}

  async take({ head, content }) {
    if (head.picture < this.number) return;
    const bitmap = await createImageBitmap(new Blob([content], { type: "image/jpeg" }));
    if (head.picture < this.number) return;
    this.bitmap?.close();
    this.bitmap = bitmap;
    this.draft = head.draft;
    this.known = head.reach;
    if (head.unseen && !this.unseen) this.say("No photo shows what is grey here.");
    this.unseen = head.unseen;
    this.times = head.milliseconds;
    if (this.settle.length) this.settle();
    else this.changed();
  }

  /** Give the picture back to the visitor's GPU, which knows nothing of what has changed meanwhile. */
  leave(viewer) {
    if (!this.canvas.hidden) Object.assign(viewer.dirty, { lights: true, camera: true });
    this.canvas.hidden = true;
    viewer.canvas.hidden = false;
  }

  /** Draw what a viewer shows. */
  async show(viewer) {
    viewer.dirty = { lights: false, camera: false, display: false };
    this.canvas.hidden = false;
    viewer.canvas.hidden = true;
    const begun = performance.now();
    const { camera } = viewer;
    const rendered = this.busy;
    try {
      if (rendered) await this.run();
      this.camera = camera; // of the picture, which markers lie on
    } catch (error) {
      viewer.say(error.message);
    }
    const { wipe, flying, frame } = viewer;
    const photo = wipe && !flying ? await viewer.frames.picture(frame).catch(() => null) : null;
    this.draw({ wipe: flying ? 0 : wipe }, photo);
    if (!rendered) return;
    viewer.milliseconds = performance.now() - begun;
    viewer.count(performance.now());
    viewer.dispatchEvent(new Event("rendered"));
    viewer.dispatchEvent(new Event("change")); // of what is known of lamps
  }

  /** What `Viewer.stats` tells. */
  stats({ page, lights, milliseconds, fps }) {
    const { length } = lights.activeEntries();
    return { adapter: "the server", size: [...page.size], lights: length, passes: this.times, milliseconds, fps };
  }

  /** Draw the picture, and the photo over a share of its width. */
  draw({ wipe }, photo) {
    const { context } = this;
    const { width, height } = this.canvas;
    if (this.bitmap) context.drawImage(this.bitmap, 0, 0, width, height);
    const columns = Math.round(wipe * width);
    if (photo && columns) context.drawImage(photo, 0, 0, columns, height, 0, 0, columns, height);
  }

  /** Point of the surface in a pixel, and its normal; null where there is none. */
  async surfaceAt(column, row) {
    const { point, normal } = await this.connection.ask("surface", { ...this.state(), places: [[column + 0.5, row + 0.5]] });
    return point && { point, normal };
  }

  /** RGB of the picture in [0, 1], row by row. */
  pixels() {
    const { width, height } = this.canvas;
    const context = new OffscreenCanvas(width, height).getContext("2d");
    context.drawImage(this.bitmap, 0, 0, width, height);
    const { data } = context.getImageData(0, 0, width, height);
    return Float32Array.from({ length: (data.length / 4) * 3 }, (_, k) => data[4 * Math.floor(k / 3) + (k % 3)] / 255);
  }
}
