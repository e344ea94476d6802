// Why a lamp changes nothing visible in a picture.

const LEAST_SHARE = 0.01; // of the light in a picture, that one light adds visibly

/**
 * Reason in a sentence; null where the lamp changes something, or nothing is known.
 * @param own of `Renderer.reach`, for the lamp
 */
export function whyUnseen(own) {
  if (!own) return null;
  if (!own.strength) return "Its brightness is zero.";
  if (own.share < LEAST_SHARE) return "It adds less than 1 % of the light in this picture: it is too dim, too far or turned away.";
  if (own.visible < LEAST_SHARE) return "Nothing in this picture sees it: a wall or a piece of furniture stands between.";
  return null;
}
