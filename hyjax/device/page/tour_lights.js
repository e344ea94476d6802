// Lights of a tour: its plan (hyjax/tour/plan.py) as the list of lights that the page shows, and back.
import { LightList } from "./light_list.js";
import { MOST_LIGHTS } from "./lights.js";
import { balanced, fileEntry, flicker, lampEntry, planLamp } from "./plan.js";

const NAMES = { bulb: "Bulb", spot: "Spot", candle: "Candle", strip: "Strip" };
const USUAL = 2700; // kelvin by which a lamp counts that was given a colour
const OUTSIDE = ["hour", "day", "latitude", "north", "weather", "windows", "open_sky"];
const DARK = { lights: [], lumen: 0, kelvin: USUAL, lux: 0 };
const UNREFINED = { schedule: "", kappa: 0, steps: 1 };

export class TourLights extends LightList {
  seconds = 0; // that candles have flickered; 0 where they burn steadily

  /** Take a plan. */
  reset(plan) {
    const { server, setup } = this.page;
    const kept = this.plain ? server.first : server.plan;
    const chosen = "latitude" in plan ? plan : kept; // the page comes with a lights file, too
    this.restored = (this.restored ?? 0) + 1;
    const before = this.items ?? [];
    this.items = (chosen.lamps ?? []).map((lamp, k) => {
      const item = this.item(lampEntry(lamp, server.lamps));
      return Object.assign(item, { on: lamp.on ?? true, id: before[k]?.id ?? item.id });
    });
    const factors = Object.entries(chosen.existing ?? {}).map(([name, left]) => [name, [left, left, left]]);
    this.existing = Object.fromEntries(factors);
    this.plain = { windows: [], pieces: [], ...structuredClone(chosen) };
    this.hour = this.plain.hour;
    this.reference = setup.reference_lux;
    this.kind ??= "bulb";
    this.refinement ??= { ...UNREFINED };
  }

  snapshot() {
    return JSON.stringify(this.plan(0));
  }

  restore(text) {
    this.reset(JSON.parse(text));
  }

  name(item) {
    const alike = this.items.filter((other) => other.entry.lamp === item.entry.lamp);
    const base = NAMES[item.entry.lamp];
    return alike.length > 1 ? `${base} ${alike.indexOf(item) + 1}` : base;
  }

  /** Metres from a surface at which a lamp hangs: a new one without an item. */
  lift(item) {
    return this.page.server.lamps[item?.entry.lamp ?? this.kind].lift;
  }

  add(position, normal) {
    const { most_lamps: most } = this.page.server;
    if (this.items.length >= most) throw new Error(`There can be at most ${most} lamps, with those that are off.`);
    if (this.activeEntries().length >= MOST_LIGHTS) throw new Error(`There can be at most ${MOST_LIGHTS} lights.`);
    const { lumen, kelvin } = this.page.server.lamps[this.kind];
    const item = this.item(lampEntry({ kind: this.kind, position, direction: normal, lumen, kelvin }, this.page.server.lamps));
    this.items.push(item);
    return item;
  }

  /** Let a lamp that was moved point away from the surface that it is put on. */
  moved({ entry }, normal) {
    for (const name of ["direction", "normal", "facing"]) if (name in entry && normal) entry[name] = normal;
  }

  /** Light from outside, as the server has found it. */
  get row() {
    return this.outside ?? DARK;
  }

  /** What the light from outside depends on. */
  get outsideKey() {
    return JSON.stringify(OUTSIDE.map((name) => this.plain[name]));
  }

  /** The ambient light takes a place, too. */
  get taken() {
    return super.taken + 1;
  }

  activeEntries() {
    const { illuminance, color } = this.ambient;
    const own = super.activeEntries().map((entry) => fileEntry(this.burning(entry)));
    return [...own, { kind: "ambient", illuminance, color }];
  }

  /** Entry as bright as it is now: candles flicker, once `seconds` go on. */
  burning(entry) {
    if (entry.lamp !== "candle" || !this.seconds) return entry;
    const number = this.items.findIndex((item) => item.entry === entry);
    return { ...entry, luminous_flux: entry.luminous_flux * flicker(this.seconds, number) };
  }

  /** Light that the room throws back, of everything that is on: `hyjax.tour.lighting.Lighting`. */
  get ambient() {
    const { walls, surface_area: area, least_ambient: least } = this.page.sun;
    const flux = this.items.filter(({ on, entry }) => on && entry.luminous_flux > 0)
      .map(({ entry }) => [this.burning(entry).luminous_flux, entry.temperature ?? USUAL]);
    flux.push([this.row.lumen, this.row.kelvin]);
    const total = flux.reduce((sum, [lumen]) => sum + lumen, 0);
    const kelvin = total > 0 ? flux.reduce((sum, [lumen, k]) => sum + lumen * k, 0) / total : 4000;
    return { illuminance: Math.max((walls * total) / (area * (1 - walls)), least), color: balanced(kelvin) };
  }

  /** Whether only the server can make the picture: of moved furniture, or with another diffusion. */
  get needsServer() {
    return this.plain.pieces.length > 0 || JSON.stringify(this.refinement) !== JSON.stringify(UNREFINED);
  }

  /** Plan as the server takes it. */
  plan(stops) {
    const existing = Object.fromEntries(Object.entries(this.existing).map(([name, [left]]) => [name, left]));
    return { ...this.plain, lamps: this.items.map(planLamp), existing, exposure: stops };
  }
}
