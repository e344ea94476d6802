// Lights of a lights file as shaders take them: the twin of hyjax/data/light_file.py and hyjax/light/kinds.

const COMMON = [
  { name: "kind", form: "any" }, { name: "name", form: "any" },
  { name: "color", form: "color" },
  { name: "temperature", form: "number", least: 1667, most: 25000 },
];
const PARALLEL = 1e-3; // length of the part of `up` across a normal below which the two are taken to be one
const LARGEST = 3.4028234e38;
export const MOST_LIGHTS = 32;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
export const scale = (a, s) => [s * a[0], s * a[1], s * a[2]];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.sqrt(dot(a, a));
export const unit = (a) => scale(a, 1 / norm(a));
export const luminance = (c) => 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];

/** Linear RGB of luminance 1 with the hue of a black body: `hyjax.light.color.blackbody`. */
export function blackbody(kelvin) {
  const u = 1e3 / kelvin;
  const x = kelvin <= 4000
    ? ((-0.2661239 * u - 0.2343589) * u + 0.8776956) * u + 0.17991
    : ((-3.0258469 * u + 2.1070379) * u + 0.2226347) * u + 0.24039;
  let y = ((3.081758 * x - 5.8733867) * x + 3.75112997) * x - 0.37001483;
  if (kelvin <= 2222) y = ((-1.1063814 * x - 1.3481102) * x + 2.18555832) * x - 0.20219683;
  else if (kelvin <= 4000) y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867;
  const xyz = [x / y, 1, (1 - x - y) / y];
  const rgb = [[3.2404542, -1.5371385, -0.4985314], [-0.969266, 1.8760108, 0.041556], [0.0556434, -0.2040259, 1.0572252]]
    .map((row) => Math.max(0, dot(row, xyz)));
  return scale(rgb, 1 / luminance(rgb));
}

/**
 * Lights of the content of a lights file. Throws an Error of one sentence for anything that is none.
 * @param content plain data, or its JSON text
 * @param page content of page.json
 */
export function parseSetup(content, page) {
  if (typeof content === "string") {
    try {
      content = JSON.parse(content);
    } catch {
      throw new Error("lights: this is not JSON.");
    }
  }
  if (!isMapping(content)) throw new Error("lights: must be a mapping with 'lights'.");
  checkKeys("lights", content, [{ name: "lights" }, { name: "existing" }, { name: "reference_lux" }, { name: "name" }]);
  const reference = content.reference_lux ?? page.default_reference_lux;
  checkNumber("lights", "reference_lux", reference, { positive: true });
  const entries = content.lights ?? [];
  if (!Array.isArray(entries)) throw new Error("lights: 'lights' must be a list of lights.");
  if (entries.length > MOST_LIGHTS) throw new Error(`lights: ${entries.length} lights; there can be at most ${MOST_LIGHTS}.`);
  const existing = checkExisting(content.existing ?? {}, page.scene.sources);
  if (!entries.length && !Object.keys(existing).length) {
    throw new Error("lights: 'lights' must be a list of at least one light, or 'existing' keep a source.");
  }
  const lights = entries.map((entry, k) => parseLight(entry, page, `light ${k}`));
  return { reference_lux: reference, lights, existing };
}

/** The light that stands where there is none. */
export const darkness = () => ({ kind: "ambient", strength: 0, color: [1, 1, 1] });

/** A light of an entry of a lights file. */
export function parseLight(entry, page, where = "light") {
  if (!isMapping(entry)) throw new Error(`${where}: must be a mapping, got ${JSON.stringify(entry)}.`);
  const keys = page.light_keys[entry.kind];
  if (!keys || !Object.hasOwn(page.light_keys, entry.kind)) {
    throw new Error(`${where}: unknown kind '${entry.kind}'; there are ${Object.keys(page.light_keys).join(", ")}.`);
  }
  where = `${where} (${entry.kind})`;
  const values = checked(where, entry, [...keys, ...COMMON]);
  if (values.color && values.temperature) throw new Error(`${where}: give either 'color' or 'temperature'.`);
  const light = { kind: entry.kind, name: entry.name };
  light.color = values.color ?? (values.temperature ? blackbody(values.temperature) : [1, 1, 1]);
  light.strength = values.luminous_flux ?? values.illuminance;
  return SHAPES[entry.kind](light, values, page.scene.up, where);
}

const radians = (degrees) => (degrees * Math.PI) / 180;

/** What makes a light of each kind from checked values. */
const SHAPES = {
  ambient: (light) => light,
  point: (light, { position, radius, clearance }) => Object.assign(light, { position, radius, clearance }),
  spot(light, values, up, where) {
    const { position, radius, clearance, target, direction, inner_degrees: inner, outer_degrees: outer } = values;
    if (!target === !direction) throw new Error(`${where}: give either 'target' (a point) or 'direction'.`);
    const most = inner ?? 0.7 * outer;
    if (most >= outer) throw new Error(`${where}: need inner_degrees < outer_degrees, got ${most} and ${outer}.`);
    const axis = direction ?? add(target, position, -1);
    if (!norm(axis)) throw new Error(`${where}: 'direction' must not be the zero vector.`);
    return Object.assign(light, { position, radius, clearance, direction: unit(axis), inner: radians(most), outer: radians(outer) });
  },
  rect: (light, values, up, where) => Object.assign(light, rectangle(values, up, where)),
  directional(light, values, up, where) {
    if (values.angular_degrees > 45) throw new Error(`${where}: 'angular_degrees' must be at most 45.`);
    Object.assign(light, { direction: unit(values.direction), angular: radians(values.angular_degrees), aperture: null });
    if (values.aperture) {
      light.aperture = rectangle(values.aperture, up, `${where}: aperture`);
      if (Math.abs(dot(light.direction, unit(cross(light.aperture.right, light.aperture.up)))) < 0.01) {
        throw new Error(`${where}: 'direction' runs along the aperture's plane; no light can come through.`);
      }
    }
    return light;
  },
  sky: (light, values, up) => Object.assign(light, { direction: unit(values.up ?? up) }),
};

/** Centre and half-axes of a rectangle as upright as can be: `Aperture.facing`. */
function rectangle(values, worldUp, where) {
  const outward = unit(values.normal);
  const reject = (v) => add(v, outward, -dot(v, outward));
  let across = reject(unit(values.up ?? worldUp));
  if (norm(across) < PARALLEL) {
    if (values.up) throw new Error(`${where}: 'up' must not be parallel to 'normal'.`);
    const least = outward.map(Math.abs).reduce((best, v, k, all) => (v < all[best] ? k : best), 0);
    across = cross(outward, [0, 1, 2].map((k) => Number(k === least)));
  }
  across = unit(across);
  return {
    center: values.center,
    right: scale(cross(across, outward), 0.5 * values.width),
    up: scale(across, 0.5 * values.height),
  };
}

// ---- checks ----

const isMapping = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

function checkKeys(where, content, keys) {
  const names = keys.map((key) => key.name);
  for (const name of Object.keys(content)) {
    if (!names.includes(name)) throw new Error(`${where}: unknown key '${name}'; there are ${names.join(", ")}.`);
  }
}

/** Values of all keys with defaults; null where a key is left out and has none. */
function checked(where, content, keys) {
  checkKeys(where, content, keys);
  const values = {};
  for (const key of keys) {
    const value = content[key.name] ?? null;
    if (value === null) {
      if (key.required) throw new Error(`${where}: key '${key.name}' is missing.`);
      values[key.name] = key.default ?? null;
    } else {
      values[key.name] = CHECKS[key.form](where, key.name, value, key);
    }
  }
  return values;
}

const isVector = (value) => Array.isArray(value) && value.length === 3 && value.every(isFinite32);
const isFinite32 = (value) => typeof value === "number" && Math.abs(value) <= LARGEST;

function checkNumber(where, name, value, { least = 0, most = LARGEST, positive = false }) {
  const fits = isFinite32(value) && value <= most && (positive ? value > 0 : value >= least);
  const range = positive ? "> 0" : `>= ${least}`;
  if (!fits) throw new Error(`${where}: '${name}' must be a number ${range}${most < 1e9 ? ` and <= ${most}` : ""}, got ${JSON.stringify(value)}.`);
  return value;
}

const CHECKS = {
  any: (where, name, value) => value,
  number: checkNumber,
  vector(where, name, value) {
    if (!isVector(value)) throw new Error(`${where}: '${name}' must be three finite numbers, got ${JSON.stringify(value)}.`);
    return value;
  },
  direction(where, name, value) {
    if (!norm(CHECKS.vector(where, name, value))) throw new Error(`${where}: '${name}' must not be the zero vector.`);
    return value;
  },
  color(where, name, value) {
    if (!isVector(value) || value.some((v) => v < 0)) {
      throw new Error(`${where}: '${name}' must be three finite numbers, none negative, got ${JSON.stringify(value)}.`);
    }
    return value;
  },
  mapping(where, name, value, key) {
    if (!isMapping(value)) throw new Error(`${where}: '${name}' must be a mapping, got ${JSON.stringify(value)}.`);
    return checked(`${where}: ${name}`, value, key.keys);
  },
};

function checkExisting(content, names) {
  if (!isMapping(content)) throw new Error("lights: 'existing' must be a mapping of sources to numbers.");
  const kept = {};
  for (const [name, value] of Object.entries(content)) {
    const known = names.length ? `there are ${names.join(", ")}` : "it knows none";
    if (!names.includes(name)) throw new Error(`existing: the photos have no source '${name}'; ${known}.`);
    const factors = typeof value === "number" ? [value, value, value] : value;
    if (!isVector(factors) || factors.some((v) => v < 0)) {
      throw new Error(`existing: '${name}' must be a number >= 0, or three, got ${JSON.stringify(value)}.`);
    }
    kept[name] = factors;
  }
  return kept;
}
