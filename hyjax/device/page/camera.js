// Cameras: those of the frames, and one that flies. Axes: x to the right, y down, z forward; metres.
import { add, cross, dot, norm, scale, unit } from "./lights.js";

const STEEPEST = 1.45; // radians above or below the horizon
const SPEED = 1.4; // metres a second
const TURN = 0.9; // radians a second

/** Camera of a frame of page.json. */
export function frameCamera({ pose, intrinsics }) {
  const column = (k) => [pose[0][k], pose[1][k], pose[2][k]];
  return { right: column(0), down: column(1), forward: column(2), origin: column(3), intrinsics };
}

/** Ray of unit depth through a pixel. */
export function rayThrough(camera, x, y) {
  const [fx, fy, cx, cy] = camera.intrinsics;
  return add(add(camera.forward, camera.right, (x - cx) / fx), camera.down, (y - cy) / fy);
}

/** Pixel [x, y] and depth of a point; null behind the camera. */
export function project(camera, point) {
  const away = add(point, camera.origin, -1);
  const depth = dot(away, camera.forward);
  if (depth < 0.05) return null;
  const [fx, fy, cx, cy] = camera.intrinsics;
  return { x: (fx * dot(away, camera.right)) / depth + cx, y: (fy * dot(away, camera.down)) / depth + cy, depth };
}

/** A camera that looks around and moves, upright. */
export class FlyingCamera {
  /**
   * @param camera that it starts from
   * @param up against gravity
   * @param bounds corners of the room, which it stays near to
   */
  constructor(camera, up, bounds) {
    this.up = unit(up);
    this.bounds = bounds;
    this.intrinsics = camera.intrinsics;
    this.origin = camera.origin;
    const level = add(camera.forward, this.up, -dot(camera.forward, this.up));
    this.north = norm(level) > 1e-3 ? unit(level) : unit(cross(this.up, camera.right));
    this.east = cross(this.north, this.up);
    this.yaw = 0;
    this.pitch = Math.asin(Math.max(-1, Math.min(1, dot(camera.forward, this.up))));
  }

  get level() {
    return add(scale(this.north, Math.cos(this.yaw)), this.east, Math.sin(this.yaw));
  }

  /** As shaders take it. */
  get camera() {
    const forward = add(scale(this.level, Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
    const right = unit(cross(forward, this.up));
    return { right, down: cross(forward, right), forward, origin: this.origin, intrinsics: this.intrinsics };
  }

  /** Turn as if the picture were dragged by pixels of it. */
  look(dx, dy) {
    this.yaw -= dx / this.intrinsics[0];
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + dy / this.intrinsics[1]));
  }

  /** Move by metres along the camera's right, the world's up, and the view. */
  move(right, up, forward) {
    const { camera } = this;
    const moved = add(add(add(this.origin, camera.right, right), this.up, up), camera.forward, forward);
    const [low, high] = this.bounds;
    this.origin = moved.map((v, k) => Math.max(low[k] - 2, Math.min(high[k] + 2, v)));
  }

  /** Move and turn for some seconds by the keys that are held; whether it did. With Shift, arrows turn. */
  step(keys, seconds) {
    const held = (...names) => Number(names.some((name) => keys.has(name)));
    const shift = held("ShiftLeft", "ShiftRight");
    const [across, along] = [held("ArrowRight") - held("ArrowLeft"), held("ArrowUp") - held("ArrowDown")];
    const right = held("KeyD") - held("KeyA") + (shift ? 0 : across);
    const forward = held("KeyW") - held("KeyS") + (shift ? 0 : along);
    const up = held("KeyE") - held("KeyQ");
    if (!right && !forward && !up && !across && !along) return false;
    const [fx, fy] = this.intrinsics;
    if (shift) this.look(-TURN * seconds * across * fx, TURN * seconds * along * fy);
    const step = SPEED * seconds * (shift ? 3 : 1);
    this.move(step * right, step * up, step * forward);
    return true;
  }
}
