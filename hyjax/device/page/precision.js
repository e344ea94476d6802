// Choice of the precision that pictures are stored with between passes.
import { Engine } from "./engine.js";

const MOST_APART = 5e-3; // share of the mean by which two precisions may differ; half precision itself makes up 1e-3

/**
 * Take the page's program of half precision where the device has it and gets a small picture right with it, else of
 * single. `?precision=f32` in the address, or f16, decides instead.
 */
export async function choosePrecision(page, device) {
  const wanted = new URLSearchParams(location.search).get("precision");
  const half = device.features.has("shader-f16") && wanted !== "f32" && (wanted === "f16" || (await agree(page.checks, device)));
  const chosen = page.programs.findIndex((program) => program.precision === (half ? "f16" : "f32"));
  page.program = page.programs[chosen];
  page.display = page.displays[chosen];
}

/** Whether a small picture comes out alike with all precisions. */
async function agree(checks, device) {
  const pictures = await Promise.all(checks.map((program) => checkedPicture(program, device).catch(() => new Float32Array([NaN]))));
  const [first, ...others] = pictures;
  const mean = first.reduce((sum, value) => sum + Math.abs(value), 0) / first.length;
  return others.every((other) => {
    const apart = first.reduce((sum, value, k) => sum + Math.abs(value - other[k]), 0) / first.length;
    return apart <= MOST_APART * mean; // and not where anything is not a number
  });
}

async function checkedPicture(program, device) {
  const engine = await Engine.create(device, program, 1);
  try {
    engine.run(["check"]);
    return await engine.download("result");
  } finally {
    engine.destroy();
  }
}
