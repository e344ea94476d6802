// Pointer and keys on the picture: look around, move, add lamps and drag them. Mouse, pen and fingers alike.
import { isLamp, placeOf } from "./light_list.js";
import { add } from "./lights.js";

const DRAG = 6; // CSS pixels from which a press is a drag
const SWIPE = 8; // frames that a swipe across the picture goes through
const WHEEL = 0.0015; // metres a step of the wheel
const PINCH = 3; // metres for fingers that part to twice their distance
const PAN = 2.5; // metres across the picture
const STEP = 0.1; // metres that a key moves a lamp
const STEPS = { // by key, along the camera's axes
  ArrowLeft: ["right", -STEP], ArrowRight: ["right", STEP], ArrowUp: ["down", -STEP], ArrowDown: ["down", STEP],
  PageUp: ["forward", STEP], PageDown: ["forward", -STEP],
};

export function connectPointer(viewer) {
  const over = document.getElementById("over");
  const markers = new Map(); // by id
  const fingers = new Map(); // by pointer
  let press = null;

  /** Pixel of the picture under an event. */
  function pixel(event) {
    const box = over.getBoundingClientRect();
    const [height, width] = viewer.page.size;
    return { x: ((event.clientX - box.left) / box.width) * width, y: ((event.clientY - box.top) / box.height) * height, scale: width / box.width };
  }

  over.addEventListener("pointerdown", (event) => {
    if (event.target !== over || event.button || viewer.tool) return;
    over.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    press = fingers.size === 1 ? { x: event.clientX, y: event.clientY, frame: viewer.frame, dragged: false } : { dragged: true };
  });

  over.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before || !press) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (!viewer.flying) {
      swipe(event); // never leaves the photos
    } else if (fingers.size === 2) {
      moveByFingers(event, dx, dy);
    } else if (press.dragged || Math.hypot(event.clientX - press.x, event.clientY - press.y) > DRAG) {
      press.dragged = true;
      const { scale } = pixel(event);
      viewer.flying.look(dx * scale, dy * scale);
      viewer.change("camera");
    } else {
      return; // the way so far counts with the next event
    }
    fingers.set(event.pointerId, event);
  });

  /** Go through the frames by a swipe to the side. */
  function swipe(event) {
    const along = event.clientX - press.x;
    if (press.frame === undefined || (!press.dragged && Math.abs(along) <= DRAG)) return;
    press.dragged = true;
    const frame = press.frame - Math.trunc((SWIPE * along) / over.clientWidth);
    const shown = Math.max(0, Math.min(viewer.frames.count - 1, frame));
    if (shown === viewer.frame) return;
    viewer.playing = false;
    viewer.goTo(shown);
  }

  function moveByFingers(event, dx, dy) {
    const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, finger]) => finger);
    const apart = (finger) => Math.max(20, Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY));
    const closer = Math.log2(apart(event) / apart(fingers.get(event.pointerId)));
    const share = (0.5 * PAN) / over.clientWidth;
    viewer.flying.move(-dx * share, dy * share, PINCH * closer);
    viewer.change("camera");
  }

  const release = (event) => {
    if (!fingers.delete(event.pointerId)) return;
    const click = event.type === "pointerup" && press && !press.dragged;
    if (!fingers.size) press = null;
    if (click && viewer.adding) addLamp(event);
  };
  over.addEventListener("pointerup", release);
  over.addEventListener("pointercancel", release);

  over.addEventListener("wheel", (event) => {
    if (!viewer.flying) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    viewer.flying.move(0, 0, -WHEEL * lines * event.deltaY);
    viewer.change("camera");
  }, { passive: false });

  async function addLamp(event) {
    const { x, y } = pixel(event);
    try {
      await viewer.addLamp(x, y);
      viewer.adding = false;
      viewer.change("display");
    } catch (error) {
      viewer.say(error.message);
    }
  }

  // ---- keys ----

  const isText = (target) => target instanceof HTMLElement && target.matches("input, select, textarea");
  const isPressed = (target) => target instanceof HTMLElement && target.matches("button, summary, a"); // by Space
  const FLIGHT = ["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE"];
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || isText(event.target)) return;
    if (FLIGHT.includes(event.code) || (viewer.flying && event.code.startsWith("Arrow"))) {
      viewer.fly();
      viewer.keys.add(event.code);
      event.preventDefault();
    } else if (event.code.startsWith("Shift")) {
      viewer.keys.add(event.code);
    } else if (event.code === "Escape") {
      if (viewer.adding) viewer.adding = false;
      else if (viewer.flying) viewer.land();
      viewer.change("display");
    } else if (event.code === "Space" && !isPressed(event.target)) {
      viewer.flying = null;
      viewer.playing = !viewer.playing;
      viewer.change("camera");
      event.preventDefault();
    }
  });
  addEventListener("keyup", (event) => viewer.keys.delete(event.code));
  addEventListener("blur", () => viewer.keys.clear());

  // ---- lamps ----

  function drawMarkers() {
    const lamps = viewer.lights.shown.filter((item) => isLamp(item.entry));
    for (const [id, marker] of markers) {
      if (lamps.some((item) => item.id === id)) continue;
      marker.remove();
      markers.delete(id);
    }
    const [height, width] = viewer.page.size;
    for (const item of lamps) {
      if (!markers.has(item.id)) markers.set(item.id, makeMarker(item.id));
      const marker = markers.get(item.id);
      const at = viewer.pixelOf(placeOf(item.entry));
      marker.hidden = !at || viewer.stage === "photo";
      marker.classList.toggle("off", !item.on);
      marker.classList.toggle("selected", viewer.selected === item.id);
      marker.title = `${viewer.lights.name(item)}: drag it, or move it by arrows, Page Up and Page Down`;
      marker.setAttribute("aria-label", viewer.lights.name(item));
      if (!at) continue;
      marker.style.left = `${(100 * at.x) / width}%`;
      marker.style.top = `${(100 * at.y) / height}%`;
    }
  }

  function makeMarker(id) {
    const lamp = () => viewer.lights.find(id); // another object after each undo
    const marker = document.createElement("button");
    marker.className = "marker";
    marker.type = "button";
    over.append(marker);
    let drag = null;
    marker.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      marker.setPointerCapture(event.pointerId);
      marker.focus({ preventScroll: true });
      drag = { x: event.clientX, y: event.clientY, at: null, moved: false, busy: false };
      viewer.selected = id;
      viewer.change("display");
    });
    marker.addEventListener("pointermove", (event) => {
      if (!drag) return;
      if (!drag.moved && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) <= DRAG) return;
      drag.moved = true;
      drag.at = pixel(event);
      follow(drag);
    });
    /** Move the lamp to where the pointer was last; one look at the surface at a time. */
    async function follow(own) {
      if (own.busy) return;
      own.busy = true;
      while (own.at) {
        const { x, y } = own.at;
        own.at = null;
        const place = await viewer.placeAt(x, y, lamp()).catch(() => null);
        if (place && lamp()) viewer.moveLamp(lamp(), place);
      }
      own.busy = false;
    }
    marker.addEventListener("click", () => { // by Enter or Space; a press has done so already
      viewer.selected = id;
      viewer.change("display");
    });
    marker.addEventListener("keydown", (event) => {
      if (!STEPS[event.code] || event.shiftKey || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      event.stopPropagation(); // arrows fly elsewhere
      const [axis, metres] = STEPS[event.code];
      if (lamp()) viewer.moveLamp(lamp(), add(placeOf(lamp().entry), viewer.camera[axis], metres));
    });
    const end = () => { drag = null; };
    marker.addEventListener("pointerup", end);
    marker.addEventListener("pointercancel", end);
    return marker;
  }

  viewer.addEventListener("change", drawMarkers);
  drawMarkers();
}
