// What the page shows, and how that stands in its address.
import type { Condition, Scene } from "./data";
import { type Curve, isWhite, luminance, type Rgb, unit, WHITE } from "./light";

export const LIT = ["background", "composite", "target", "effect"] as const;
export const STORED = ["depth", "normal", "albedo", "ids"] as const;
export const PANES = [...LIT, ...STORED] as const;
export type Pane = (typeof PANES)[number];
export const LAYOUTS = ["divide", "pair", "all"] as const;
export type Layout = (typeof LAYOUTS)[number];
export const CURVES: Curve[] = ["soft", "clip", "stops"];
export type Side = "scene" | "object";

/** What is done to one light: its power in stops, and a colour of luminance 1 that it is multiplied by. */
export interface Lamp { on: boolean; solo: boolean; stops: number; tint: Rgb }
/** A lighting; `name` is that of the stored condition that it was last set to. */
export interface Lighting { name: string; lamps: Lamp[]; ev: number }
export interface State {
  scene: number; view: number; object: string; left: Pane; right: Pane; layout: Layout; divider: number; curve: Curve;
  edits: Side; linked: boolean; lightings: Record<Side, Lighting>; pick: { x: number; y: number; pane: Pane } | null;
}

export function lightingOf(condition: Condition, scene: Scene): Lighting {
  const lamps = scene.lights.map(({ name }) => {
    const gain = condition.gains[name] ?? [0, 0, 0];
    const power = luminance(gain);
    const tint: Rgb = Math.max(...gain) === Math.min(...gain) ? WHITE : unit(gain);
    return power > 0 ? { on: true, solo: false, stops: Math.log2(power), tint } : { on: false, solo: false, stops: 0, tint: WHITE };
  });
  return { name: condition.name, lamps, ev: condition.exposure_ev };
}

export function isOn(lighting: Lighting, lamp: Lamp): boolean {
  return lighting.lamps.some((each) => each.solo) ? lamp.solo : lamp.on;
}

/** The gain of a light and channel, without exposure. */
export function gainOf(lighting: Lighting, lamp: Lamp): Rgb {
  const power = isOn(lighting, lamp) ? 2 ** lamp.stops : 0;
  return [power * lamp.tint[0], power * lamp.tint[1], power * lamp.tint[2]];
}

/** The condition's file, as `multilight mix --condition` takes it. */
export function conditionOf(lighting: Lighting, scene: Scene, name: string): Condition {
  const gains = lighting.lamps.map((lamp, i) => [scene.lights[i].name, gainOf(lighting, lamp).map((value) => round(value, 6))] as const);
  const lit = gains.filter(([, gain]) => Math.max(...gain) > 0);
  return { name, gains: Object.fromEntries(lit) as Record<string, Rgb>, exposure_ev: round(lighting.ev, 4) };
}

const worded = new WeakMap<Condition, string>();

/** The stored condition that a lighting is, if it is one. */
export function storedAs(lighting: Lighting, scene: Scene): Condition | undefined {
  const wanted = inWords(lighting);
  return scene.conditions.find((condition) => {
    const words = worded.get(condition) ?? inWords(lightingOf(condition, scene));
    worded.set(condition, words);
    return words === wanted;
  });
}

export function sideLit(state: State, side: Side): Lighting {
  return state.lightings[state.linked ? "scene" : side];
}

export function toHash(state: State, scene: Scene): string {
  const words = new URLSearchParams({
    scene: String(state.scene), view: String(state.view), object: state.object, layout: state.layout, left: state.left,
    right: state.right, divider: String(round(state.divider, 3)), curve: state.curve, edits: state.edits,
  });
  for (const side of ["scene", "object"] as const) {
    const lighting = state.lightings[side];
    words.set(`${side}_light`, storedAs(lighting, scene)?.name ?? inWords(lighting));
  }
  if (state.linked) words.set("linked", "1");
  if (state.pick) words.set("pick", `${state.pick.x},${state.pick.y},${state.pick.pane}`);
  return words.toString();
}

/** Read an address over a state of the same scene; what is none of the scene's is left as it is. */
export function fromHash(hash: string, state: State, scene: Scene): void {
  const words = new URLSearchParams(hash);
  const one = <T extends string>(key: string, known: readonly T[], old: T): T => known.find((each) => each === words.get(key)) ?? old;
  const number = (key: string, low: number, high: number, old: number): number => {
    const value = Number(words.get(key) ?? NaN);
    return value >= low && value <= high ? value : old;
  };
  state.view = Math.round(number("view", 0, scene.views - 1, state.view));
  state.object = one("object", scene.objects, state.object);
  state.layout = one("layout", LAYOUTS, state.layout);
  state.left = one("left", PANES, state.left);
  state.right = one("right", PANES, state.right);
  state.divider = number("divider", 0, 1, state.divider);
  state.curve = one("curve", CURVES, state.curve);
  state.edits = one("edits", ["scene", "object"], state.edits);
  state.linked = words.get("linked") === "1";
  for (const side of ["scene", "object"] as const) {
    const text = words.get(`${side}_light`) ?? "";
    const stored = scene.conditions.find((condition) => condition.name === text);
    state.lightings[side] = (stored ? lightingOf(stored, scene) : read(text, scene)) ?? state.lightings[side];
  }
  const [x, y, pane] = (words.get("pick") ?? "").split(",");
  const picked = { x: Number(x), y: Number(y), pane: PANES.find((each) => each === pane) };
  const inside = picked.x >= 0 && picked.x < scene.width && picked.y >= 0 && picked.y < scene.height;
  state.pick = inside && picked.pane ? { x: Math.floor(picked.x), y: Math.floor(picked.y), pane: picked.pane } : null;
}

/** `0.5;1:-1;0:0:1.2_0.9_0.5;s1:2`: the exposure, then each light: solo, on, stops, tint. */
function inWords(lighting: Lighting): string {
  const lamps = lighting.lamps.map(({ on, solo, stops, tint }) => {
    const colour = isWhite(tint) ? "" : `:${tint.map((value) => round(value, 4)).join("_")}`;
    return `${solo ? "s" : ""}${on ? 1 : 0}:${round(stops, 4)}${colour}`;
  });
  return [round(lighting.ev, 4), ...lamps].join(";");
}

function read(text: string, scene: Scene): Lighting | null {
  const [ev, ...words] = text.split(";");
  const lamps: Lamp[] = [];
  for (const word of words) {
    const found = /^(s?)([01]):(-?[\d.]+(?:e-?\d+)?)(?::([\d.]+)_([\d.]+)_([\d.]+))?$/.exec(word);
    if (!found) return null;
    const tint: Rgb = found[4] === undefined ? WHITE : [Number(found[4]), Number(found[5]), Number(found[6])];
    lamps.push({ on: found[2] === "1", solo: found[1] === "s", stops: Number(found[3]), tint });
  }
  const numbers = [Number(ev), ...lamps.flatMap((lamp) => [lamp.stops, ...lamp.tint])];
  const sound = numbers.every((value) => Math.abs(value) <= 64);
  return lamps.length === scene.lights.length && sound ? { name: "mixed", lamps, ev: Number(ev) } : null;
}

export function round(value: number, digits: number): number {
  return Number(value.toFixed(digits));
}
