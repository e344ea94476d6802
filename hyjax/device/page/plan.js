// Plan of a tour (hyjax/tour/plan.py) and the page's lights: what is sent to the server, and what comes from a file.
import { placeOf } from "./light_list.js";
import { add, blackbody, luminance, scale, unit } from "./lights.js";

const STRIP = [1, 0.03]; // metres
const SPOT_DEGREES = [20, 40];
const BALANCE = 0.43; // share of a light's distance from neutral that white balance makes up for
const NEUTRAL = 6500; // kelvin

/** Colour that a light has in the picture: `hyjax.tour.lighting`. */
export function balanced(kelvin) {
  const neutral = 1 / NEUTRAL;
  return blackbody(Math.round(1 / (neutral + (1 - BALANCE) * (1 / kelvin - neutral))));
}

/** Entry of a lights file for a lamp of a plan. `lamp` keeps what a lights file has no word for. */
export function lampEntry({ kind, position, direction, lumen, kelvin, color }, lamps) {
  const common = { luminous_flux: lumen, lamp: kind, ...(color ? { color: scale(color, 1 / luminance(color)) } : { temperature: kelvin }) };
  const axis = unit(direction ?? [0, 0, -1]);
  const { radius } = lamps[kind];
  if (kind === "spot") {
    const [inner, outer] = SPOT_DEGREES;
    return { kind: "spot", position, direction: axis, inner_degrees: inner, outer_degrees: outer, radius, ...common };
  }
  if (kind === "strip") return { kind: "rect", center: position, normal: axis, width: STRIP[0], height: STRIP[1], ...common };
  return { kind: "point", position, radius, facing: axis, ...common };
}

/** Lamp of a plan for an item of the list. */
export function planLamp({ entry, on }) {
  const position = placeOf(entry);
  const direction = entry.direction ?? entry.normal ?? entry.facing ?? (entry.target ? add(entry.target, position, -1) : [0, 0, -1]);
  const kinds = { point: "bulb", spot: "spot", rect: "strip" };
  const lamp = { kind: entry.lamp ?? kinds[entry.kind], position, direction, lumen: entry.luminous_flux, on };
  if (entry.color) lamp.color = entry.color;
  else lamp.kelvin = Math.min(20000, Math.max(1700, entry.temperature ?? NEUTRAL));
  return lamp;
}

/** Factor on the light of a candle, a lamp of some number: `hyjax.tour.lighting`. */
export function flicker(seconds, number) {
  const t = seconds + 13.7 * number;
  return 1 + 0.08 * Math.sin(9.1 * t) + 0.06 * Math.sin(14.3 * t + 1) + 0.05 * Math.sin(3.7 * t + 2);
}

/** Entry as a lights file has it, with the colour that the camera's white balance leaves. */
export function fileEntry({ lamp, facing, temperature, ...entry }) {
  if (!lamp || entry.color) return entry; // also what comes from outside
  return { ...entry, color: balanced(temperature) };
}
