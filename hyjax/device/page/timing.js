// Times of a program's stages: interleaved rounds after a warm-up, by the GPU's clock or the browser's.

const MOST_REPEATS = 64; // runs of one sample
const FEWEST_ROUNDS = 10;
const WALL_SHARE = 4; // samples by the browser's clock are so many times longer

/** Timestamps around a whole submission, in the place of the engine's timer of single passes. */
class SpanTimer {
  constructor(device) {
    this.device = device;
    this.set = device.createQuerySet({ type: "timestamp", count: 2 });
    this.resolved = device.createBuffer({ size: 256, usage: GPUBufferUsage.QUERY_RESOLVE | GPUBufferUsage.COPY_SRC });
    this.copy = device.createBuffer({ size: 256, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    this.passes = 0;
  }

  begin() {
    this.seen = 0;
  }

  writes() {
    const first = this.seen === 0;
    const last = ++this.seen === this.passes;
    if (!first && !last) return undefined;
    return {
      querySet: this.set,
      ...(first ? { beginningOfPassWriteIndex: 0 } : {}),
      ...(last ? { endOfPassWriteIndex: 1 } : {}),
    };
  }

  end(encoder) {
    encoder.resolveQuerySet(this.set, 0, 2, this.resolved, 0);
    encoder.copyBufferToBuffer(this.resolved, 0, this.copy, 0, 16);
  }

  async milliseconds() {
    await this.copy.mapAsync(GPUMapMode.READ);
    const [start, end] = new BigUint64Array(this.copy.getMappedRange(0, 16));
    this.copy.unmap();
    return Number(end - start) / 1e6;
  }

  destroy() {
    this.set.destroy();
    this.resolved.destroy();
    this.copy.destroy();
  }
}

/** Milliseconds of one run of a stage, over so many of them in one submission. */
async function sample(engine, timer, stage, repeats) {
  const { device, program } = engine;
  const stages = Array(repeats).fill(stage);
  const encoder = device.createCommandEncoder();
  if (timer) timer.passes = repeats * program.launches.filter((launch) => launch.stage === stage).length;
  engine.encode(encoder, stages, { timed: Boolean(timer) });
  const commands = encoder.finish();
  const start = performance.now();
  device.queue.submit([commands]);
  if (timer) return (await timer.milliseconds()) / repeats;
  await device.queue.onSubmittedWorkDone();
  return (performance.now() - start) / repeats;
}

/** Random pictures: what is computed with zeros takes less power. */
function fill(engine) {
  for (const name of ["light", "guide"]) {
    const floats = engine.program.precision === "f32";
    const words = new Uint32Array(engine.buffers[name].size / 4);
    let state = 1;
    for (let k = 0; k < words.length; k++) {
      state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
      // Floats of [1, 2), or pairs of half floats of [1, 2).
      words[k] = floats ? 0x3f800000 | (state >>> 9) : 0x3c003c00 | ((state >>> 6) & 0x03ff03ff);
    }
    engine.upload(name, words);
  }
}

const visible = () => new Promise((done) => {
  const look = () => {
    if (document.visibilityState !== "visible") return;
    document.removeEventListener("visibilitychange", look);
    done();
  };
  document.addEventListener("visibilitychange", look);
  look();
});

/**
 * Time every stage of a program in turns.
 *
 * @param engine with a program whose stages are "0", "1", ...
 * @param request how, see docs/latency_format.md
 * @param done rounds that have been reported before
 * @param report takes { round, milliseconds, warm_up, last } and says whether to go on
 * @param say takes what is done just now
 */
export async function timeJob(engine, request, done, report, say) {
  const { device } = engine;
  const stages = request.schedules.map((_, k) => `${k}`);
  const timer = device.features.has("timestamp-query") ? new SpanTimer(device) : null;
  const before = engine.timer;
  engine.timer = timer;
  fill(engine);
  try {
    say("Warming up …");
    const start = performance.now();
    const rough = stages.map(() => 0);
    let runs = 0;
    do {
      for (const [k, stage] of stages.entries()) {
        await visible();
        rough[k] = await sample(engine, timer, stage, 1);
        runs++;
      }
    } while (performance.now() - start < 1000 * request.warm_up_seconds);
    const warmUp = { seconds: (performance.now() - start) / 1000, runs };
    const wanted = request.sample_ms * (timer ? 1 : WALL_SHARE);
    const repeats = rough.map((ms) => Math.min(MOST_REPEATS, Math.max(1, Math.ceil(wanted / Math.max(ms, 1e-3)))));
    const begun = performance.now();
    for (let round = done; round < request.rounds; round++) {
      const milliseconds = [];
      for (const [k, stage] of stages.entries()) {
        await visible();
        let ms = await sample(engine, timer, stage, repeats[k]);
        for (let again = 0; !(ms > 0) && again < 3; again++) { // below the clock's resolution
          repeats[k] *= 4;
          ms = await sample(engine, timer, stage, repeats[k]);
        }
        if (!(ms > 0)) throw new Error("The clock of the graphics processor does not move.");
        milliseconds.push(ms);
      }
      const late = performance.now() - begun > 1000 * request.most_seconds;
      const last = round + 1 >= request.rounds || (late && round + 1 >= FEWEST_ROUNDS);
      if (!(await report({ round, milliseconds, warm_up: warmUp, last }))) return;
    }
  } finally {
    engine.timer = before;
    timer?.destroy();
  }
}
