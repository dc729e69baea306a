// What is changed: lightings, stored conditions, each light, exposure and tone curve.
import type { Light, Scene, View } from "./data";
import { h, icon, segments, slider, slug } from "./dom";
import { COLDEST, type Curve, DAYLIGHT, decode, display, encode, isWhite, meter, type Rgb, tintBetween, unit, WHITE } from "./light";
import { mixSmall, type Small, shrunk } from "./paint";
import { cssOf, signed } from "./stage";
import { gainOf, isOn, type Lamp, type Lighting, lightingOf, sideLit, type Side, type State, storedAs } from "./state";

const STOPS = 6;
/** Stops that the slider of the exposure goes beyond those of the stored conditions. */
const BEYOND = 4;
/** Reciprocal of the coldest and hottest white on the sliders [1/MK], and how near a tint must be to one. */
const WARM = -Math.round(1e6 / COLDEST);
const COOL = -80;
const NEAR = 0.02;
const THUMBNAIL = 96;
const METERED = 32;

interface Row { sync(lighting: Lighting, lamp: Lamp): void; element: HTMLElement }

export class Panel {
  readonly element: HTMLElement;
  private readonly sides;
  private readonly link;
  private readonly rows: Row[];
  private readonly conditions: { button: HTMLButtonElement; canvas: HTMLCanvasElement }[];
  private readonly exposure;
  private readonly exposureText = h("output", { class: "value" });
  private readonly curves;
  private small: { view: View; metered: Small } | null = null;

  constructor(private readonly state: State, private readonly scene: Scene, private readonly change: () => void) {
    this.sides = segments<Side>("side", "Which lighting is changed", [["scene", "The lighting of the scene: background, target, effect", "Scene"], ["object", "The lighting of the pasted object: composite", "Object"]], (side) => { state.edits = side; if (side === "object") state.linked = false; change(); });
    this.link = h("input", { type: "checkbox", role: "switch", onchange: () => { state.linked = this.link.checked; if (state.linked) state.edits = "scene"; else state.lightings.object = structuredClone(state.lightings.scene); change(); } });
    this.conditions = scene.conditions.map((condition) => {
      const canvas = h("canvas", { "aria-hidden": "true" });
      const button = h("button", { class: "condition", "aria-pressed": "false", title: slug(condition.name), onclick: () => { this.light(lightingOf(condition, scene)); } }, canvas, h("span", {}, slug(condition.name)));
      return { button, canvas };
    });
    this.rows = scene.lights.map((light, i) => this.row(light, i));
    const exposures = scene.conditions.map((condition) => condition.exposure_ev);
    this.exposure = slider("Exposure", Math.floor(Math.min(...exposures)) - BEYOND, Math.ceil(Math.max(...exposures)) + BEYOND, 0.05, (ev) => { this.lighting.ev = ev; change(); });
    this.curves = segments<Curve>("curve", "Tone curve", [["soft", "The project's: highlights roll off, as multilight mix writes PNG", "Soft"], ["clip", "sRGB alone: what is too bright is cut", "Clip"], ["stops", "False colours: stops of luminance about middle grey", "Stops"]], (curve) => { state.curve = curve; change(); });
    this.element = h("section", { class: "panel", "aria-label": "Lighting" },
      h("div", { class: "group" },
        h("div", { class: "line" }, h("h2", {}, "Lighting of"), this.sides),
        h("label", { class: "switch" }, this.link, h("span", {}, "Light the object as the scene"))),
      h("div", { class: "group" }, h("div", { class: "line" }, h("h2", {}, "Conditions"), h("span", { class: "hint" }, "as stored with the scene")), h("div", { class: "conditions" }, ...this.conditions.map(({ button }) => button))),
      h("div", { class: "group" },
        h("div", { class: "line" }, h("h2", {}, "Lights"), h("button", { class: "text", onclick: () => this.light({ ...this.lighting, lamps: scene.lights.map(() => ({ on: true, solo: false, stops: 0, tint: WHITE })) }) }, icon("reset"), "All as made")),
        h("ul", { class: "lights" }, ...this.rows.map((row) => row.element))),
      h("div", { class: "group" },
        h("div", { class: "line" }, h("h2", {}, "Exposure"), this.exposureText, h("button", { class: "text", title: "Expose as a camera would on this view", onclick: () => this.meter() }, icon("meter"), "Meter")),
        this.exposure,
        h("div", { class: "line" }, h("h2", {}, "Tone curve"), this.curves)));
  }

  /** Turn a light on or off, or solo. */
  toggle(i: number, what: "on" | "solo"): void {
    const lamp = this.lighting.lamps[i];
    if (!lamp) return;
    lamp[what] = !lamp[what];
    this.change();
  }

  sync(): void {
    const { lighting, state } = this;
    this.sides.show(state.edits);
    this.link.checked = state.linked;
    this.rows.forEach((row, i) => row.sync(lighting, lighting.lamps[i]));
    this.exposure.show(lighting.ev, `${signed(lighting.ev, 2)} EV`);
    this.exposureText.value = `${signed(lighting.ev, 2)} EV`;
    this.curves.show(state.curve);
    const stored = storedAs(lighting, this.scene)?.name;
    this.conditions.forEach(({ button }, i) => button.setAttribute("aria-pressed", String(this.scene.conditions[i].name === stored)));
  }

  /** Paint the thumbnails of a view. */
  show(view: View): void {
    if (this.small?.view === view) return;
    this.small = { view, metered: shrunk(view, METERED) };
    const small = shrunk(view, THUMBNAIL);
    this.conditions.forEach(({ canvas }, i) => {
      const lighting = lightingOf(this.scene.conditions[i], this.scene);
      const picture = mixSmall(small, gains(lighting, 2 ** lighting.ev));
      const image = new ImageData(small.width, small.height);
      for (let at = 0; at < picture.length; at += 3) display("soft", picture[at], picture[at + 1], picture[at + 2], image.data, (at / 3) * 4);
      Object.assign(canvas, { width: small.width, height: small.height });
      (canvas.getContext("2d") as CanvasRenderingContext2D).putImageData(image, 0, 0);
    });
  }

  private get lighting(): Lighting {
    return sideLit(this.state, this.state.edits);
  }

  private light(lighting: Lighting): void {
    this.state.lightings[this.state.linked ? "scene" : this.state.edits] = lighting;
    this.change();
  }

  private meter(): void {
    if (!this.small) return;
    this.lighting.ev = meter(mixSmall(this.small.metered, gains(this.lighting, 1)));
    this.change();
  }

  private row(light: Light, i: number): Row {
    const own = light.kelvin ?? DAYLIGHT;
    const lamp = () => this.lighting.lamps[i];
    const name = slug(light.name);
    const set = (values: Partial<Lamp>) => { Object.assign(lamp(), values); this.change(); };
    const power = h("button", { class: "lamp", role: "switch", "aria-label": name, title: `Turn ${name} on or off`, onclick: () => this.toggle(i, "on") }, h("span", { class: "bulb" }));
    const solo = h("button", { class: "solo", "aria-label": `Only ${name}`, title: `Only ${name}`, onclick: () => this.toggle(i, "solo") }, "S");
    const reset = h("button", { class: "quiet", "aria-label": `${name} as made`, title: "As made", onclick: () => set({ on: true, stops: 0, tint: WHITE }) }, icon("reset"));
    const stops = slider(`Power of ${name} in stops`, -STOPS, STOPS, 0.05, (value) => set({ stops: value }), { class: "about" });
    const kelvin = slider(`Colour of ${name} in kelvin`, WARM, COOL, 1, (mired) => {
      const tint = tintBetween(own, -1e6 / mired);
      temperatures.set(tint, -1e6 / mired);
      set({ tint });
    }, { class: "kelvin" });
    const colour = h("input", { type: "color", "aria-label": `Colour of ${name} as RGB`, title: "Any colour", oninput: () => set({ tint: fromHex(colour.value) }) });
    const [stopsText, kelvinText] = [h("output", { class: "value" }), h("output", { class: "value" })];
    const element = h("li", { class: "light" },
      h("div", { class: "head" }, power, h("div", { class: "what" }, h("strong", {}, name), h("span", { title: light.about }, light.about)), solo, reset),
      h("div", { class: "dials" },
        h("label", {}, h("span", { class: "key" }, "Power"), stopsText, stops),
        h("label", {}, h("span", { class: "key" }, "Colour"), kelvinText, kelvin), colour));
    let synced = "";
    const sync = (lighting: Lighting, now: Lamp): void => {
      const on = isOn(lighting, now);
      const words = JSON.stringify([on, now]);
      if (words === synced) return;
      synced = words;
      element.classList.toggle("off", !on);
      power.setAttribute("aria-checked", String(now.on));
      solo.setAttribute("aria-pressed", String(now.solo));
      stops.show(now.stops, `${signed(now.stops, 2)} stops`);
      stopsText.value = signed(now.stops, 2);
      const found = temperatureOf(now.tint, own);
      const text = isWhite(now.tint) && light.kelvin === null ? "as made" : found === null ? "RGB" : `${Math.round(found / 10) * 10} K`;
      kelvin.show(-1e6 / (found ?? own), text);
      kelvinText.value = text;
      const hex = toHex(now.tint);
      if (colour.value !== hex && document.activeElement !== colour) colour.value = hex;
      power.style.setProperty("--colour", cssOf(light.colour.map((value, c) => value * now.tint[c]) as Rgb));
    };
    return { sync, element };
  }
}

/** Gains of each light and channel (L, 3) times `scale`, and each light's own `scales`. */
export function gains(lighting: Lighting, scale: number, scales?: number[]): Float32Array {
  return Float32Array.from(lighting.lamps.flatMap((lamp, i) => gainOf(lighting, lamp).map((gain) => gain * scale * (scales?.[i] ?? 1))));
}

/** Temperatures of tints that were found already; null of those that are no other white's. */
const temperatures = new WeakMap<Rgb, number | null>();

function temperatureOf(tint: Rgb, own: number): number | null {
  if (isWhite(tint)) return own;
  const known = temperatures.get(tint);
  if (known !== undefined) return known;
  let [best, least] = [0, NEAR];
  for (let mired = -COOL; mired <= -WARM; mired += 1) {
    const white = tintBetween(own, 1e6 / mired);
    const off = Math.max(...white.map((value, c) => Math.abs(value - tint[c])));
    if (off < least) [best, least] = [1e6 / mired, off];
  }
  temperatures.set(tint, best || null);
  return best || null;
}

function toHex(tint: Rgb): string {
  const peak = Math.max(...tint);
  return `#${tint.map((value) => Math.round(255 * encode(value / peak)).toString(16).padStart(2, "0")).join("")}`;
}

function fromHex(hex: string): Rgb {
  const rgb = [1, 3, 5].map((at) => decode(parseInt(hex.slice(at, at + 2), 16) / 255)) as Rgb;
  return unit(rgb);
}
