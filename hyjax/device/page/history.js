// Undo and redo: what was set up, step by step. Changes that follow each other at once are one step; so is a drag.
import { button, made } from "./fields.js";

const STEP = 350; // milliseconds of rest that end a step
const MOST_STEPS = 200;
const TYPED = "input:not([type=range], [type=checkbox], [type=color]), textarea";

export function connectHistory(viewer) {
  const take = () => JSON.stringify([viewer.lights.snapshot(), viewer.stops]);
  const done = [take()];
  const undone = [];
  let timer = 0;

  const note = () => {
    clearTimeout(timer);
    const now = take();
    if (now !== done.at(-1)) {
      done.push(now);
      undone.length = 0;
      if (done.length > MOST_STEPS) done.shift();
    }
    show();
  };

  function restore() {
    const [lights, stops] = JSON.parse(done.at(-1));
    viewer.lights.restore(lights);
    viewer.stops = stops;
    document.getElementById("exposure").value = stops;
    if (!viewer.lights.find(viewer.selected)) viewer.selected = null;
    viewer.change("lights", "display");
    done[done.length - 1] = take(); // directions and colours are scaled anew: no step of its own
  }

  function undo() {
    note();
    if (done.length < 2) return;
    undone.push(done.pop());
    restore();
    show();
  }

  function redo() {
    note();
    if (!undone.length) return;
    done.push(undone.pop());
    restore();
    show();
  }

  const back = button("Undo", undo, { title: "Ctrl+Z" });
  const forth = button("Redo", redo, { title: "Ctrl+Shift+Z" });
  document.querySelector("#panel header").append(made("div", { className: "buttons", id: "history" }, back, forth));

  function show() {
    back.disabled = done.length < 2;
    forth.disabled = !undone.length;
  }

  let pressed = false;
  const later = () => {
    clearTimeout(timer);
    timer = setTimeout(() => (pressed ? later() : note()), STEP);
  };
  addEventListener("pointerdown", () => {
    note(); // what was before is a step of its own
    pressed = true;
  }, true);
  for (const name of ["pointerup", "pointercancel"]) addEventListener(name, () => { pressed = false; }, true);
  addEventListener("blur", () => { pressed = false; }); // of the window: a menu took the pointer
  viewer.addEventListener("change", later);
  addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || event.target.matches?.(TYPED)) return;
    const key = event.key.toLowerCase();
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    if (key === "y" || event.shiftKey) redo();
    else undo();
  });
  show();
}
