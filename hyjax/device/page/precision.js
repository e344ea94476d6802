// Choice of the precision that pictures are stored with between passes.
import { Engine } from "./engine.js";

const MOST_APART = 5e-3; // share of the mean by which two precisions may differ; half precision itself makes up 1e-3

/**
 * Take the page's program of half precision where the device has it and gets a small picture right with it, else of
 * single. `?precision=f32` in the address, or f16, decides instead. Throws an Error where neither gives a picture.
 */
export async function choosePrecision(page, device) {
  const wanted = new URLSearchParams(location.search).get("precision");
  const able = device.features.has("shader-f16");
  const checks = page.checks.filter(({ precision }) => able || precision === "f32");
  const pictures = Object.fromEntries(await Promise.all(checks.map(async (program) => {
    const picture = await checkedPicture(program, device).catch(() => []);
    const sound = mean(picture) > 0 && mean(picture) < Infinity; // neither black nor with what is not a number
    return [program.precision, sound ? picture : null];
  })));
  const { f32: single, f16: half } = pictures;
  if (!single && !half) {
    throw new Error("This device's graphics get even a small picture wrong; its driver may be faulty.");
  }
  const trusted = half && (!single || alike(single, half));
  const chosen = able && (wanted === "f16" || (wanted !== "f32" && trusted)) ? "f16" : "f32";
  const number = page.programs.findIndex(({ precision }) => precision === chosen);
  page.program = page.programs[number];
  page.display = page.displays[number];
}

/** Mean amount; not a number where any value is none, or there are no values. */
const mean = (values) => values.reduce((sum, value) => sum + Math.abs(value), 0) / values.length;

/** Whether two pictures differ by no more than their precisions. */
const alike = (a, b) => mean(a.map((value, k) => value - b[k])) <= MOST_APART * mean(a);

async function checkedPicture(program, device) {
  const engine = await Engine.create(device, program, 1);
  try {
    engine.run(["check"]);
    return await engine.download("result");
  } finally {
    engine.destroy();
  }
}
