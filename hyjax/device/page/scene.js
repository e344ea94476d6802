// Content of an exported page: page.json, the arrays of scene.bin, and the frames.

export const PAGE_FORMAT = 3;
const TYPES = { uint16: Uint16Array, uint32: Uint32Array, float32: Float32Array };
const KEPT_BYTES = 64e6; // of decoded frames
const LEAST_LIGHT = 0.05; // of the photos, of its mean

const held = JSON.parse(document.getElementById("files")?.textContent ?? "{}"); // base64, in a page of a single file

async function read(name) {
  if (held[name]) return new Response(Uint8Array.from(atob(held[name]), (letter) => letter.charCodeAt(0)));
  const response = await fetch(name).catch(() => {
    throw new Error(`${name} could not be loaded: the connection or the server is gone.`);
  });
  if (!response.ok) throw new Error(`${name} is missing on this server (${response.status}).`);
  return response;
}

const isCut = (name) => new Error(`${name} came cut off or changed: load the page again, or copy its folder to the server once more.`);

/** Content of a file of JSON. */
export async function loadJson(name) {
  const text = await (await read(name)).text().catch(() => { throw isCut(name); });
  if (/^\s*</.test(text)) {
    throw new Error(`This server answers with a web page where it was asked for ${name}: `
      + "copy the exported folder to it as a whole.");
  }
  try {
    return JSON.parse(text);
  } catch {
    throw isCut(name);
  }
}

/** Content of page.json. */
export async function loadPage() {
  const page = await loadJson("page.json");
  if (page.format !== PAGE_FORMAT) throw new Error(`page.json has format ${page.format}; these scripts read ${PAGE_FORMAT}.`);
  return page;
}

/**
 * Arrays of scene.bin, as buffers of the program take them.
 * @param progress called with the share that is loaded
 */
export async function loadArrays(page, progress) {
  const response = await read(page.file.name);
  const unpacked = counted(response, progress).pipeThrough(new DecompressionStream(page.file.compression));
  const bytes = await new Response(unpacked).arrayBuffer().catch(() => null);
  if (bytes?.byteLength !== page.file.bytes) throw isCut(page.file.name);
  const arrays = {};
  for (const entry of page.arrays) {
    const count = entry.shape.reduce((product, side) => product * side, 1);
    const values = new TYPES[entry.dtype](bytes, entry.offset, count);
    if (entry.differences) for (let k = 1; k < count; k++) values[k] += values[k - 1];
    arrays[entry.name] = values instanceof Uint16Array ? Uint32Array.from(values) : values;
  }
  arrays.fields = fourthNumbers(arrays.fields);
  return arrays;
}

function counted(response, progress) {
  const total = Number(response.headers.get("content-length"));
  let seen = 0;
  return response.body.pipeThrough(new TransformStream({
    transform(chunk, controller) {
      seen += chunk.byteLength;
      if (total) progress(Math.min(1, seen / total));
      controller.enqueue(chunk);
    },
  }));
}

/** Vectors of three numbers as vectors of four, as shaders have them. */
function fourthNumbers(values) {
  const result = new Float32Array((values.length / 3) * 4);
  for (let k = 0; 3 * k < values.length; k++) result.set(values.subarray(3 * k, 3 * k + 3), 4 * k);
  return result;
}

/**
 * Arrays with the light of the photos to a power, and its sources in proportion, as `SurfaceLight.raised` has them.
 * @param count of sources
 */
export function raised(arrays, count, exponent = 1) {
  if (exponent === 1) return arrays;
  const [fields, sources] = [arrays.fields.slice(), arrays.sources.slice()];
  const lightAt = (number) => 16 * Math.floor(number / 3) + 8 + (number % 3); // in fields, of four vectors a vertex
  const numbers = sources.length / count; // of a source
  for (let k = 0; k < sources.length; k++) {
    sources[k] *= Math.max(fields[lightAt(k % numbers)], LEAST_LIGHT) ** (exponent - 1);
  }
  for (let k = 0; k < (3 * fields.length) / 16; k++) fields[lightAt(k)] **= exponent;
  return { ...arrays, fields, sources };
}

/** Pictures of the frames, decoded when they are needed; the last ones are kept. */
export class Frames {
  constructor(page) {
    this.entries = page.frames;
    this.size = page.size;
    this.decoded = new Map();
    const [height, width] = page.size;
    this.kept = Math.max(4, Math.floor(KEPT_BYTES / (4 * width * height))); // pictures
  }

  get count() {
    return this.entries.length;
  }

  /** Forget all pictures: frames have other numbers now. */
  forget() {
    for (const bitmap of this.decoded.values()) bitmap.then((picture) => picture.close(), () => {});
    this.decoded.clear();
  }

  /** Picture of a frame as an ImageBitmap. */
  picture(index) {
    let found = this.decoded.get(index);
    this.decoded.delete(index);
    found ??= this.decode(index);
    this.decoded.set(index, found); // the newest is last
    if (this.decoded.size > this.kept) {
      const [oldest, bitmap] = this.decoded.entries().next().value;
      this.decoded.delete(oldest);
      bitmap.then((picture) => picture.close(), () => {});
    }
    found.catch(() => this.decoded.delete(index));
    return found;
  }

  async decode(index) {
    const { file } = this.entries[index];
    const blob = await (await read(file)).blob();
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    const [height, width] = this.size;
    if (bitmap.width !== width || bitmap.height !== height) throw new Error(`${file} is not ${width} x ${height} pixels.`);
    return bitmap;
  }
}
