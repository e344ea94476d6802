// Handles of windows and furniture on the picture, and the tools that draw and pick them.
import { project } from "./camera.js";
import { made } from "./fields.js";
import { add, cross, dot, norm, scale, unit } from "./lights.js";

const DRAG = 6; // CSS pixels from which a press is a drag
const STEP = 0.05; // metres that an arrow key moves
const SMALLEST = 0.1;
const LARGEST = 5; // metres
const FARTHEST = 15; // metres to where furniture can be dragged
const HINTS = {
  window: "Draw a rectangle on a wall, or click there for a window of the usual size",
  furniture: "Click on a piece of furniture",
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

// ---- places ----

const apply = (pose, p) => [0, 1, 2].map((r) => pose[4 * r] * p[0] + pose[4 * r + 1] * p[1] + pose[4 * r + 2] * p[2] + pose[4 * r + 3]);

/** Where the middle of a piece of furniture is. */
export const anchorOf = (piece) => apply(piece.pose, piece.centre ?? piece.seed);

function level(up) {
  const axis = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  return unit(add(axis, up, -dot(axis, up)));
}

/** Radians that a piece is turned about the vertical. */
export function angleOf(piece, up) {
  const e = level(unit(up));
  const turned = add(apply(piece.pose, e), apply(piece.pose, [0, 0, 0]), -1);
  return Math.atan2(dot(cross(e, turned), unit(up)), dot(e, turned));
}

/** Turn a piece from how it was scanned, and put its middle somewhere. */
export function placePiece(piece, worldUp, angle, anchor) {
  const up = unit(worldUp);
  const column = (e) => add(add(scale(e, Math.cos(angle)), cross(up, e), Math.sin(angle)), up, (1 - Math.cos(angle)) * dot(up, e));
  const columns = [column([1, 0, 0]), column([0, 1, 0]), column([0, 0, 1])];
  const from = piece.centre ?? piece.seed;
  const turned = [0, 1, 2].map((r) => columns[0][r] * from[0] + columns[1][r] * from[1] + columns[2][r] * from[2]);
  const shift = add(anchor, turned, -1);
  piece.pose = [0, 1, 2].flatMap((r) => [columns[0][r], columns[1][r], columns[2][r], shift[r]]).concat([0, 0, 0, 1]);
}

/** Half-axes of a window, as long as half its sides. */
function sides({ normal, width, height }, up) {
  const inward = unit(normal);
  let high = add(unit(up), inward, -dot(unit(up), inward));
  if (norm(high) < 1e-2) high = level(inward);
  high = unit(high);
  return [scale(cross(high, inward), 0.5 * width), scale(high, 0.5 * height)];
}

/** Where the ray through a pixel meets a plane; null where it does not. */
function onPlane(viewer, { x, y }, point, normal) {
  const { origin } = viewer.camera;
  const ray = viewer.ray(x, y);
  const along = dot(ray, normal);
  const t = dot(add(point, origin, -1), normal) / along;
  return Math.abs(along) > 1e-3 && t > 0 && t < FARTHEST ? add(origin, ray, t) : null;
}

// ---- handles ----

export function connectHandles(viewer) {
  const over = document.getElementById("over");
  const { lights, page } = viewer;
  const outline = made("div", { id: "outline" });
  over.append(outline);
  let handles = [];

  const pixel = ({ clientX, clientY }) => {
    const area = over.getBoundingClientRect();
    return { x: ((clientX - area.left) / area.width) * page.size[1], y: ((clientY - area.top) / area.height) * page.size[0] };
  };

  /** Handles that there should be: name, place, and what moves them. */
  function wanted() {
    const result = [];
    lights.plain.windows.forEach((opening, index) => {
      const own = { field: "windows", index };
      const chosen = isChosen(own);
      const move = (to) => { opening.center = to; };
      result.push({ own, key: `w${index}`, label: `Window ${index + 1}`, place: opening.center, kind: "pane", normal: opening.normal, move, axes: sides(opening, page.scene.up) });
      if (!chosen) return;
      for (const [sx, sy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        const [across, high] = sides(opening, page.scene.up);
        const corner = add(add(opening.center, across, sx), high, sy);
        const opposite = add(add(opening.center, across, -sx), high, -sy);
        const size = (to) => {
          const away = add(to, opposite, -1);
          const limit = (v, s) => s * Math.min(LARGEST, Math.max(SMALLEST, s * v));
          const [w, h] = [limit(dot(away, unit(across)), sx), limit(dot(away, unit(high)), sy)];
          Object.assign(opening, { width: Math.abs(w), height: Math.abs(h), center: add(add(opposite, unit(across), w / 2), unit(high), h / 2) });
        };
        const label = `${sy > 0 ? "Upper" : "Lower"} ${sx < 0 ? "left" : "right"} corner of window ${index + 1}`;
        result.push({ own, key: `w${index}${sx}${sy}`, label, place: corner, kind: "corner", normal: opening.normal, move: size, axes: sides(opening, page.scene.up) });
      }
    });
    lights.plain.pieces.forEach((piece, index) => {
      const { up } = page.scene;
      const move = (to) => placePiece(piece, up, angleOf(piece, up), to);
      const forward = add(viewer.camera.forward, unit(up), -dot(viewer.camera.forward, unit(up)));
      const far = norm(forward) > 1e-3 ? unit(forward) : level(up);
      result.push({ own: { field: "pieces", index }, key: `p${index}`, label: `Piece ${index + 1}`, place: anchorOf(piece), kind: "piece", normal: up, move, axes: [cross(far, unit(up)), far] });
    });
    return result;
  }

  const isChosen = ({ field, index }) => viewer.thing?.field === field && viewer.thing.index === index;

  function draw() {
    const things = viewer.stage === "photo" ? [] : wanted();
    for (const handle of handles.filter(({ key }) => !things.some((thing) => thing.key === key))) handle.element.remove();
    handles = things.map((thing) => {
      const element = handles.find(({ key }) => key === thing.key)?.element ?? make(thing.key);
      const at = viewer.pixelOf(thing.place);
      element.hidden = !at;
      element.className = `marker handle ${thing.kind}`;
      element.classList.toggle("selected", isChosen(thing.own));
      element.setAttribute("aria-label", thing.label);
      element.title = thing.label;
      if (at) {
        element.style.left = `${(100 * at.x) / page.size[1]}%`;
        element.style.top = `${(100 * at.y) / page.size[0]}%`;
      }
      return { ...thing, element };
    });
    drawOutline();
  }

  function drawOutline() {
    const lines = viewer.stage === "photo" ? [] : lights.plain.windows.map((opening, index) => {
      const [across, high] = sides(opening, page.scene.up);
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([sx, sy]) => project(viewer.camera, add(add(opening.center, across, sx), high, sy)));
      if (corners.some((corner) => !corner)) return null;
      const points = corners.map(({ x, y }) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");
      return `<polygon points="${points}" class="${isChosen({ field: "windows", index }) ? "selected" : ""}" />`;
    });
    outline.innerHTML = `<svg viewBox="0 0 ${page.size[1]} ${page.size[0]}" aria-hidden="true">${lines.filter(Boolean).join("")}</svg>`;
  }

  function make(key) {
    const element = made("button", { type: "button" });
    over.append(element);
    const own = () => handles.find((handle) => handle.key === key);
    let drag = null;
    element.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      element.setPointerCapture(event.pointerId);
      element.focus({ preventScroll: true });
      const { place } = own();
      drag = { x: event.clientX, y: event.clientY, moved: false, offset: null, place };
      viewer.thing = own().own;
      viewer.change("display");
    });
    element.addEventListener("pointermove", (event) => {
      if (!drag || (!drag.moved && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) <= DRAG)) return;
      const { place, normal, move } = own();
      drag.offset ??= add(place, onPlane(viewer, pixel({ clientX: drag.x, clientY: drag.y }), place, normal) ?? place, -1);
      const to = onPlane(viewer, pixel(event), drag.place, normal);
      drag.moved = true;
      if (!to) return;
      move(add(to, drag.offset));
      viewer.change("lights");
    });
    for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, () => { drag = null; });
    element.addEventListener("click", (event) => {
      if (event.detail) return; // by pointer, which has selected it
      viewer.thing = own().own;
      viewer.change("display");
    });
    element.addEventListener("keydown", (event) => {
      const arrow = ARROWS[event.code];
      if (!arrow || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      event.stopPropagation();
      const { place, axes, move } = own();
      move(add(add(place, unit(axes[0]), STEP * arrow[0]), unit(axes[1]), STEP * arrow[1]));
      viewer.change("lights");
    });
    return element;
  }

  connectTools(viewer, over, pixel);
  viewer.addEventListener("change", draw);
  draw();
}

// ---- tools ----

function connectTools(viewer, over, pixel) {
  const drawn = made("div", { id: "drawn", hidden: true });
  over.append(drawn);
  const { lights, connection } = viewer;
  let press = null;

  async function use(tool, places) {
    viewer.tool = null;
    try {
      const content = { ...viewer.state(), places: places.map(({ x, y }) => [x, y]) };
      const answer = await connection.ask(tool, content);
      const field = tool === "window" ? "windows" : "pieces";
      const thing = answer.window ?? answer.new;
      if (thing) lights.plain[field].push(thing);
      viewer.thing = { field, index: thing ? lights.plain[field].length - 1 : answer.piece };
      viewer.selected = null;
      viewer.change("lights");
    } catch (error) {
      viewer.say(error.message);
      viewer.change("display");
    }
  }

  viewer.useTool = use;
  over.addEventListener("pointerdown", (event) => {
    if (!viewer.tool || event.button) return;
    event.preventDefault();
    over.setPointerCapture(event.pointerId);
    press = { x: event.clientX, y: event.clientY, at: pixel(event) };
  });
  over.addEventListener("pointermove", (event) => {
    if (!press || viewer.tool !== "window") return;
    const area = over.getBoundingClientRect();
    const [left, right] = [press.x, event.clientX].sort((a, b) => a - b);
    const [top, bottom] = [press.y, event.clientY].sort((a, b) => a - b);
    Object.assign(drawn.style, { left: `${left - area.left}px`, top: `${top - area.top}px`, width: `${right - left}px`, height: `${bottom - top}px` });
    drawn.hidden = Math.hypot(right - left, bottom - top) <= DRAG;
  });
  over.addEventListener("pointerup", (event) => {
    if (!press || !viewer.tool) return;
    const dragged = Math.hypot(event.clientX - press.x, event.clientY - press.y) > DRAG;
    const places = dragged && viewer.tool === "window" ? [press.at, pixel(event)] : [press.at];
    drawn.hidden = true;
    press = null;
    use(viewer.tool, places);
  });
  over.addEventListener("pointercancel", () => {
    drawn.hidden = true;
    press = null;
  });
  addEventListener("keydown", ({ code }) => {
    if (code !== "Escape" || !viewer.tool) return;
    viewer.tool = null;
    viewer.change("display");
  });
  viewer.addEventListener("change", () => {
    document.body.classList.toggle("pointing", Boolean(viewer.tool));
    if (!viewer.tool) return;
    const hint = document.getElementById("hint");
    hint.hidden = false;
    hint.textContent = HINTS[viewer.tool];
  });
}
