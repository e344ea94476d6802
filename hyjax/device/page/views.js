// Views of the lights' shadow maps: the twin of hyjax/light/kinds and of `hyjax.geometry.shadow_caster.MapLayout`.
import { add, cross, dot, norm, scale, unit } from "./lights.js";

const GOLDEN = Math.PI * (3 - Math.sqrt(5)); // angle of a Fibonacci spiral
const PLASTIC = 1.32471795724474602596;
const WIDEST_PERSPECTIVE = 0.5; // cosine; wider spots have hemisphere maps
const SPHERE = Math.sqrt(4 * Math.PI); // extents of maps
const HEMISPHERE = Math.sqrt(2 * Math.PI);
const UPRIGHT = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** Axes x, y and z, with z along a direction: `hyjax.util.vectors.orthonormal_frame`. */
function frameOf(direction) {
  const z = unit(direction);
  const sizes = z.map(Math.abs);
  const least = sizes.indexOf(Math.min(...sizes));
  const x = unit(cross(z, UPRIGHT[least].map((v) => -v)));
  return [x, cross(z, x), z];
}

function spherePoint(k, count) {
  const z = 1 - (2 * k + 1) / count;
  const ring = Math.sqrt(1 - z * z);
  return [ring * Math.cos(k * GOLDEN), ring * Math.sin(k * GOLDEN), z];
}

const along = (axes, [x, y, z]) => add(add(scale(axes[0], x), axes[1], y), axes[2], z);
const spots = (light, count) => Array.from({ length: count }, (_, k) => (
  light.radius > 0 ? add(light.position, spherePoint(k, 8), light.radius) : light.position));

/**
 * Views of a light's shadow map; null for a light without shadows.
 * @param room center and reach of parallel rays: centre of the mesh and half its diagonal
 * @returns origins; axes of each view; extent: width of the map at one metre's distance, or in metres
 */
export function shadowViews(light, room) {
  return VIEWS[light.kind]?.(light, room) ?? null;
}

const alike = (origins, axes, extent) => ({ origins, axes: origins.map(() => axes), extent });

const VIEWS = {
  point: (light) => alike(spots(light, light.radius > 0 ? 8 : 1), UPRIGHT, SPHERE),
  spot(light) {
    const cosine = Math.cos(light.outer);
    // A margin of five percent: sources of a wide lamp see the rim of the cone from aside.
    const extent = cosine < WIDEST_PERSPECTIVE ? HEMISPHERE : (2.1 * Math.sqrt(1 - cosine * cosine)) / cosine;
    return alike(spots(light, light.radius > 0 ? 8 : 1), frameOf(light.direction), extent);
  },
  rect({ center, right, up }) {
    const place = (k, step) => 2 * ((0.5 + k * step) % 1) - 1;
    const origins = Array.from({ length: 16 }, (_, k) => (
      add(add(center, right, place(k, 1 / PLASTIC)), up, place(k, 1 / (PLASTIC * PLASTIC)))));
    return alike(origins, frameOf(cross(right, up)), HEMISPHERE);
  },
  directional(light, room) {
    const own = frameOf(light.direction);
    const turned = (k) => {
      const radius = light.angular * Math.sqrt((k + 0.5) / 4);
      return frameOf(along(own, [radius * Math.cos(k * GOLDEN), radius * Math.sin(k * GOLDEN), 1]));
    };
    const axes = light.angular > 0 ? Array.from({ length: 4 }, (_, k) => turned(k)) : [own];
    return parallel(axes, light.aperture, room);
  },
  sky(light, room) {
    const own = frameOf(light.direction);
    return parallel(Array.from({ length: 32 }, (_, k) => frameOf(scale(along(own, spherePoint(k, 64)), -1))), null, room);
  },
};

function parallel(axes, aperture, { center, reach }) {
  if (aperture) {
    const half = 1.02 * Math.hypot(norm(aperture.right), norm(aperture.up));
    return { origins: axes.map(() => aperture.center), axes, extent: 2 * half };
  }
  return { origins: axes.map((frame) => add(center, frame[2], -reach)), axes, extent: 2 * reach };
}
