// Lights of the page: those that it came with, lamps that were added, and the sun by the hour.
import { MOST_LIGHTS, blackbody, luminance, parseLight, parseSetup } from "./lights.js";

const NAMES = { point: "Lamp", spot: "Spot", rect: "Window light", directional: "Sun", ambient: "Ambient light", sky: "Sky" };
const BRIGHTEST = 100_000; // lumens that a lamp's brightness can be set to, as in hyjax/tour/plan.py
const NEW_LAMP = { kind: "point", luminous_flux: 800, temperature: 2700, radius: 0.05 };

/** Key of an entry that its brightness is proportional to. */
export const strengthKey = (entry) => ("luminous_flux" in entry ? "luminous_flux" : "illuminance");
/** Whether a light hangs in the room, where it can be moved. */
export const isLamp = (entry) => entry.kind === "point" || entry.kind === "spot" || "lamp" in entry;
/** Where a lamp is. */
export const placeOf = (entry) => entry.position ?? entry.center;

export class LightList {
  constructor(page) {
    this.page = page;
    this.number = 0;
    this.reset(page.setup);
  }

  /** Take the content of a lights file. Throws an Error of one sentence, and changes nothing, if it is none. */
  reset(content) {
    const setup = parseSetup(content, this.page);
    const { lights } = typeof content === "string" ? JSON.parse(content) : content;
    this.items = structuredClone(lights ?? []).map((entry) => this.item(entry));
    this.reference = setup.reference_lux;
    this.existing = setup.existing;
    this.hour = null;
  }

  /** All that can be set up, as text; see `restore`. */
  snapshot() {
    const { items, reference, existing, hour } = this;
    return JSON.stringify({ items, reference, existing, hour });
  }

  restore(text) {
    Object.assign(this, JSON.parse(text));
    this.restored = (this.restored ?? 0) + 1; // items are other objects now
  }

  item(entry) {
    this.number += 1;
    const strength = entry[strengthKey(entry)];
    const lamp = Math.max(strength, Math.min(BRIGHTEST, Math.max(3000, 3 * strength)));
    return { id: this.number, entry, on: true, most: isLamp(entry) ? lamp : Math.max(3 * strength, 10) };
  }

  find(id) {
    return this.items.find((item) => item.id === id);
  }

  name(item) {
    if (item.entry.name) return String(item.entry.name);
    const alike = this.items.filter((other) => other.entry.kind === item.entry.kind);
    const base = NAMES[item.entry.kind];
    return alike.length > 1 ? `${base} ${alike.indexOf(item) + 1}` : base;
  }

  /** Add a lamp; the new item. Throws if there are too many. */
  add(position) {
    if (this.activeEntries().length >= MOST_LIGHTS) throw new Error(`There can be at most ${MOST_LIGHTS} lights.`);
    const item = this.item({ ...NEW_LAMP, position });
    this.items.push(item);
    return item;
  }

  remove(id) {
    this.items = this.items.filter((item) => item.id !== id);
  }

  setTemperature(item, kelvin) {
    delete item.entry.color;
    item.entry.temperature = kelvin;
  }

  /** Linear RGB of any brightness; only its hue is taken. */
  setColor(item, rgb) {
    const light = luminance(rgb);
    delete item.entry.temperature;
    item.entry.color = light > 0 ? rgb.map((v) => v / light) : [1, 1, 1];
  }

  color(item) {
    return item.entry.color ?? (item.entry.temperature ? blackbody(item.entry.temperature) : [1, 1, 1]);
  }

  /** Items that are part of the picture's light: by the hour, the outside is the table's. */
  get shown() {
    return this.hour === null ? this.items : this.items.filter((item) => isLamp(item.entry));
  }

  get row() {
    if (this.hour === null || !this.page.sun) return null;
    const { rows } = this.page.sun;
    return rows.reduce((best, row) => (Math.abs(row.hour - this.hour) < Math.abs(best.hour - this.hour) ? row : best));
  }

  activeEntries() {
    const outside = this.row?.lights ?? [];
    return [...this.active.map((item) => item.entry), ...outside];
  }

  /** Lights beside the items. */
  get taken() {
    return this.row?.lights.length ?? 0;
  }

  /** Items that are on, no more than the shaders take beside the other lights. */
  get active() {
    return this.shown.filter((item) => item.on).slice(0, MOST_LIGHTS - this.taken);
  }

  /** Illuminance that the camera exposes for: by the hour it follows what lamps add, as in `hyjax.tour.lighting`. */
  get exposure() {
    const { row, page } = this;
    if (!row) return this.reference;
    const { adaptation, walls, surface_area: area, least_ambient: least } = page.sun;
    const lumen = this.shown.reduce((sum, item) => sum + (item.on ? item.entry.luminous_flux : 0), 0);
    const lux = Math.max(row.lux + (2 * walls * lumen) / (area * (1 - walls)), 2 * least);
    return Math.max(lux, lux ** adaptation * page.default_reference_lux ** (1 - adaptation));
  }

  /** As the renderer takes it. */
  setup() {
    const lights = this.activeEntries().map((entry, k) => parseLight(entry, this.page, `light ${k}`));
    return { reference_lux: this.exposure, lights, existing: this.existing };
  }

  /** Number of an item among the lights of `setup`; -1 if it is off. */
  numberOf(id) {
    return this.active.findIndex((item) => item.id === id);
  }

  /** Content of a lights file. */
  content() {
    return { reference_lux: this.exposure, lights: this.activeEntries(), existing: this.existing };
  }
}
