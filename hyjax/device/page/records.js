// Lights, camera, windows and lamps as records of the shaders: the twin of hyjax/device/light_records.py and renderer.py.
import { add, cross, dot, norm } from "./lights.js";
import { shadowViews } from "./views.js";

const KINDS = { ambient: 0, point: 1, spot: 2, rect: 3, directional: 4, sky: 5 };
const WITHIN = 0.1; // metres from a source within which a new light makes it shine
export const RECORD_WORDS = 32;
const SIZE = 2; // words of a record: texels a side of the shadow map,
const COLOR = 20; // where colour and strength begin,
const TEXEL = 30; // and the width of a texel

/**
 * Records of lights, with shadow maps in full size.
 * @param lights from parseSetup
 * @param scene of page.json
 * @param resolutions texels a side of a map with one view, and of each of several
 * @returns words; views: origin and axes of each view, four numbers a vector; of each light: jobs, the full size of its
 *   map and the width of what it covers; texels of all maps
 */
export function lightRecords(lights, scene, resolutions) {
  const words = new Float32Array(RECORD_WORDS * lights.length);
  const heads = new Uint32Array(words.buffer);
  const [low, high] = scene.bounds;
  const room = { center: [0, 1, 2].map((k) => 0.5 * (low[k] + high[k])), reach: 0.5 * norm(add(high, low, -1)) * 1.01 };
  // Light that falls on any surface alike is left out where bounces stand in for it.
  const uniform = lights.every((light) => light.kind === "ambient");
  const records = { words, heads, views: [], jobs: [], sizes: [], extents: [], texels: 0 };
  lights.forEach((light, number) => {
    const at = RECORD_WORDS * number;
    const put = (field, vector, w) => {
      if (vector) words.set(vector, at + 4 * field);
      if (w !== undefined) words[at + 4 * field + 3] = w;
    };
    const views = shadowViews(light, room) ?? { origins: [], axes: [], extent: 0 };
    const count = views.origins.length;
    const size = count ? resolutions[Number(count > 1)] : 0;
    heads.set([KINDS[light.kind], count, 0, count ? records.texels : 0], at);
    put(5, light.color, light.kind === "ambient" && !uniform ? 0 : light.strength);
    put(6, room.center, room.reach);
    put(7, [scene.slack ?? -1, Number(Boolean(light.aperture)), 0], records.views.length / 16);
    SHAPES[light.kind]?.(put, light);
    records.sizes.push(size);
    records.extents.push(views.extent);
    if (count) sizeMap(records, number, size);
    records.jobs.push(Array.from({ length: count }, (_, view) => [number, view, 0, 0]));
    views.origins.forEach((origin, k) => records.views.push(...[origin, ...views.axes[k]].flatMap((vector) => [...vector, 0])));
    records.texels += count * (size + 2) ** 2;
  });
  return records;
}

/** Make a light's shadow map of another size, no larger than its full one. */
export function sizeMap({ words, heads, extents }, number, size) {
  heads[RECORD_WORDS * number + SIZE] = size;
  words[RECORD_WORDS * number + TEXEL] = extents[number] / size;
}

/** Texels a side of a light's shadow map. */
export const mapSize = (records, number) => records.heads[RECORD_WORDS * number + SIZE];

const putRectangle = (put, { center, right, up }) => {
  put(1, center);
  put(3, right);
  put(4, up);
};

/** What each kind puts into its record. Fields: 1 position, 2 direction, 3 right, 4 up. */
const SHAPES = {
  point(put, light) {
    put(1, light.position, light.radius);
    put(2, null, light.clearance);
  },
  spot(put, light) {
    put(1, light.position, light.radius);
    put(2, light.direction, light.clearance);
    put(3, null, Math.cos(light.inner));
    put(4, null, Math.cos(light.outer));
  },
  rect: putRectangle,
  directional(put, light) {
    put(2, light.direction);
    put(1, null, light.angular);
    if (light.aperture) putRectangle(put, light.aperture);
  },
  sky: (put, light) => put(2, light.direction),
};

/** Numbers of lights whose shadow maps must be cast anew: all but colour, strength and the map's present size decide. */
export function movedLights(records, last) {
  const free = (k) => k === SIZE || k === TEXEL || (k >= COLOR && k < COLOR + 4);
  const moved = [];
  records.jobs.forEach((jobs, number) => {
    if (!jobs.length) return;
    const at = RECORD_WORDS * number;
    const same = last && last.jobs.length > number && last.sizes[number] === records.sizes[number]
      && records.words.subarray(at, at + RECORD_WORDS).every((value, k) => free(k) || Object.is(value, last.words[at + k]));
    if (!same) moved.push(number);
  });
  return moved;
}

/** Filter where nothing of a frame is known: of the lights that fall on any surface alike, else 1. */
export function ambientFilter(lights, reference) {
  const ambient = lights.filter((light) => light.kind === "ambient");
  if (!ambient.length) return [1, 1, 1];
  return [0, 1, 2].map((k) => ambient.reduce((sum, light) => sum + (light.strength * light.color[k]) / reference, 0));
}

/** What is left of each source of the photo, and last the light that bounces are filled up to; four numbers each. */
export function keptVectors(existing, { sources, filled_share }, lights, reference) {
  const ambient = lights.some((light) => light.kind === "ambient");
  // Lights that fall on any surface alike are left where there are no others.
  const fills = ambient && lights.some((light) => light.kind !== "ambient");
  const least = fills ? ambientFilter(lights, reference).map((x) => filled_share * x) : [0, 0, 0];
  return new Float32Array([...sources.flatMap((name) => [...(existing[name] ?? [0, 0, 0]), 0]), ...least, 0]);
}

/** What panes and lamps send under new lights: `hyjax.light.emission.radiant_filter`. */
function radiantFilter(lights, { panes, lamps }, reference) {
  const sent = Array.from({ length: panes.length + lamps.length }, () => [0, 0, 0]);
  const shine = (k, light, factor) => { sent[k] = add(sent[k], light.color, (light.strength * factor) / reference); };
  for (const light of lights) {
    if (light.kind === "rect") {
      const area = 4 * norm(cross(light.right, light.up));
      panes.forEach(([center, right, up], k) => {
        const away = add(light.center, center, -1);
        const normal = cross(right, up);
        const near = Math.abs(dot(away, normal)) / norm(normal) < WITHIN;
        const inside = Math.abs(dot(away, right)) <= dot(right, right) && Math.abs(dot(away, up)) <= dot(up, up);
        if (near && inside) shine(k, light, 1 / area);
      });
    } else if (light.kind === "point" || light.kind === "spot") {
      lamps.forEach(([x, y, z, radius], k) => {
        if (norm(add(light.position, [x, y, z], -1)) < radius + WITHIN) {
          shine(panes.length + k, light, 1 / (4 * Math.PI * radius ** 2));
        }
      });
    } else if (light.kind === "sky") {
      panes.forEach((_, k) => shine(k, light, 1));
    }
  }
  return sent;
}

/** Panes and lamps as wgsl/composite.wgsl takes them. */
export function emitterVectors(lights, reference, existing, scene) {
  const sent = radiantFilter(lights, scene, reference);
  const kept = sent.map((_, k) => existing[scene.sources[k]] ?? [0, 0, 0]);
  const rows = [];
  scene.panes.forEach((pane, k) => rows.push(...pane, sent[k], kept[k], scene.pane_means[k], ...scene.pane_bars[k]));
  scene.lamps.forEach((lamp, k) => rows.push(lamp, sent[scene.panes.length + k], kept[scene.panes.length + k]));
  return new Float32Array(rows.flatMap((row) => [...row, 0].slice(0, 4)));
}

/**
 * `struct Frame` of wgsl/frame.wgsl.
 * @param camera { right, down, forward, origin, intrinsics }
 * @param options counts: of lights, panes and lamps; albedo: whether the frame is the mesh's own albedo
 */
export function frameRecord(camera, { counts, albedo, ambient, reference, mean }) {
  const words = new Float32Array(32);
  words.set(camera.right, 0);
  words.set(camera.down, 4);
  words.set(camera.forward, 8);
  words.set(camera.origin, 12);
  words.set(camera.intrinsics, 16);
  new Uint32Array(words.buffer).set([...counts, Number(albedo)], 20);
  words.set([...ambient, 1 / reference], 24);
  words.set(mean, 28);
  return words;
}
