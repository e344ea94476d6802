// Places in the picture: what surface is there, and where a lamp on it goes.
import { rayThrough } from "./camera.js";
import { placeOf } from "./light_list.js";
import { add, dot } from "./lights.js";

const OFF_SURFACE = 0.3; // metres from the surface that a lamp is put at

/** Where a lamp goes that is put at a pixel, with the surface's `normal`; null where there is no surface. */
export async function placeAt(viewer, x, y, item) {
  const [height, width] = viewer.page.size;
  const column = Math.floor(x);
  const row = Math.floor(y);
  if (column < 0 || row < 0 || column >= width || row >= height) return null;
  const found = await surfaceAt(viewer, column, row);
  if (!found) return null;
  const { point, normal } = found;
  const place = add(point, normal, viewer.lights.lift?.(item) ?? OFF_SURFACE);
  if (viewer.height === null) return Object.assign(place, { normal });
  const { up, bounds } = viewer.page.scene;
  const floor = dot(bounds[0].map((low, k) => (up[k] > 0 ? low : bounds[1][k])), up);
  return Object.assign(add(place, up, floor + viewer.height - dot(place, up)), { normal });
}

/** Point of the surface in a pixel, and its normal; null where there is none. */
async function surfaceAt(viewer, column, row) {
  if (viewer.usesServer) return viewer.remote.surfaceAt(column, row);
  const surface = await viewer.renderer.surfaceAt(column, row);
  if (!surface) return null;
  const { camera } = viewer.renderer;
  return { point: add(camera.origin, rayThrough(camera, column + 0.5, row + 0.5), surface.depth), normal: surface.normal };
}

/** Put a lamp of a list somewhere. */
export function moveEntry(lights, item, position) {
  const { entry } = item;
  if (entry.target) { // it goes on pointing the same way
    entry.target = add(entry.target, add(position, placeOf(entry), -1));
  }
  lights.moved?.(item, position.normal);
  entry[entry.center ? "center" : "position"] = [...position];
}
