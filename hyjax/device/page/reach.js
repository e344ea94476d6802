// Why a lamp changes nothing visible in a picture.
import { placeOf, strengthKey } from "./light_list.js";

const LEAST_SHARE = 0.01; // of the light in a picture, that one light adds visibly

/**
 * Reason in words; null where the lamp changes something, or nothing is known.
 * @param item of the list of lights
 * @param own share of the light in the picture without shadows, and the share of it that they leave: `Renderer.reach`
 * @param bounds of the room
 */
export function whyUnseen({ on, entry }, own, bounds) {
  if (!on) return "it is switched off";
  if (!entry[strengthKey(entry)]) return "its brightness is zero";
  if (!own || (own.share >= LEAST_SHARE && own.visible >= LEAST_SHARE)) return null;
  if (placeOf(entry)?.some((v, k) => v < bounds[0][k] || v > bounds[1][k])) return "it hangs outside the room";
  if (own.share < LEAST_SHARE) return "it adds less than 1 % of the light in this picture: it is too dim, too far or turned away";
  return "nothing in this picture sees it: a wall or a piece of furniture stands between";
}
