// Arithmetic on light, as `lights/` and `datagen/tuples/` of the project define it.
import whites from "./whites.json";

export type Rgb = [number, number, number];
export type Curve = "soft" | "clip" | "stops";

export const WHITE: Rgb = [1, 1, 1];
export const MIDDLE_GREY = 0.18;
/** Light that states no temperature counts as daylight [K]. */
export const DAYLIGHT = 6504;
/** Range of the colour temperatures on offer [K]. */
export const COLDEST = whites[0][0];
export const HOTTEST = whites[whites.length - 1][0];
const SHOULDER = 0.6;
const FADE = 0.15;
/** A colour for each stop of luminance about middle grey, from -6 to +6. */
export const STOPS: Rgb[] = [
  [22, 10, 40], [52, 22, 92], [64, 46, 148], [44, 86, 178], [26, 128, 170], [22, 158, 134], [128, 128, 128],
  [104, 190, 84], [178, 208, 62], [238, 208, 60], [250, 158, 48], [242, 96, 54], [255, 240, 244],
];

export function luminance(rgb: ArrayLike<number>, at = 0): number {
  return 0.2126 * rgb[at] + 0.7152 * rgb[at + 1] + 0.0722 * rgb[at + 2];
}

/** Scale a colour to luminance 1. */
export function unit(rgb: Rgb): Rgb {
  const grey = luminance(rgb);
  return grey > 0 ? [rgb[0] / grey, rgb[1] / grey, rgb[2] / grey] : WHITE;
}

export function encode(linear: number): number {
  const x = Math.min(Math.max(linear, 0), 1);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/** `encode` as 8 bits, of so many steps. */
const STEPS = 1 << 14;
const ENCODED = Uint8ClampedArray.from({ length: STEPS + 1 }, (_, step) => 255 * encode(step / STEPS));

export function decode(encoded: number): number {
  return encoded <= 0.04045 ? encoded / 12.92 : ((encoded + 0.055) / 1.055) ** 2.4;
}

/** The colour of white light of a temperature [K], of luminance 1: `temperature_to_rgb`, between rows of a table. */
export function whiteOf(kelvin: number): Rgb {
  const mired = 1e6 / Math.min(Math.max(kelvin, COLDEST), HOTTEST);
  let row = 1;
  while (row < whites.length - 1 && 1e6 / whites[row][0] > mired) row += 1;
  const [low, high] = [whites[row - 1], whites[row]];
  const t = (mired - 1e6 / low[0]) / (1e6 / high[0] - 1e6 / low[0]);
  return unit([1, 2, 3].map((c) => low[c] + t * (high[c] - low[c])) as Rgb);
}

/** What light of one temperature is multiplied by to have another, luminance kept. */
export function tintBetween(own: number, wanted: number): Rgb {
  const [from, to] = [whiteOf(own), whiteOf(wanted)];
  return unit([0, 1, 2].map((c) => Math.min(Math.max(to[c] / Math.max(from[c], 1e-3), 0.1), 10)) as Rgb);
}

/** Write 8-bit sRGB of exposed linear radiance: tone curve, transfer curve. */
export function display(curve: Curve, r: number, g: number, b: number, out: Uint8ClampedArray, at: number): void {
  r = Math.max(r, 0);
  g = Math.max(g, 0);
  b = Math.max(b, 0);
  if (curve === "stops") {
    const stop = Math.log2(Math.max(luminance([r, g, b]), 1e-9) / MIDDLE_GREY);
    out.set(STOPS[Math.min(Math.max(Math.round(stop), -6), 6) + 6], at);
  } else {
    const peak = Math.max(r, g, b);
    if (curve === "soft" && peak > SHOULDER) {
      const room = 1 - SHOULDER;
      const newPeak = 1 - (room * room) / (peak + room - SHOULDER);
      const kept = 1 / (FADE * (peak - newPeak) + 1);
      const scale = (newPeak / peak) * kept;
      const faded = newPeak * (1 - kept);
      r = r * scale + faded;
      g = g * scale + faded;
      b = b * scale + faded;
    }
    out[at] = ENCODED[(Math.min(r, 1) * STEPS + 0.5) | 0];
    out[at + 1] = ENCODED[(Math.min(g, 1) * STEPS + 0.5) | 0];
    out[at + 2] = ENCODED[(Math.min(b, 1) * STEPS + 0.5) | 0];
  }
  out[at + 3] = 255;
}

/** The exposure [EV] at which a camera would take a picture of unexposed radiance (N x 3): `meter_condition`. */
export function meter(picture: Float32Array): number {
  const all: number[] = [];
  for (let at = 0; at < picture.length; at += 3) all.push(luminance(picture, at));
  all.sort((a, b) => a - b);
  const seen = all.filter((value) => value > 0);
  if (!seen.length) return 0;
  const bright = percentile(seen, 97);
  const lit = seen.filter((value) => value >= 1e-3 * bright);
  const [low, high] = [percentile(lit, 5), percentile(lit, 95)];
  const logs = lit.map((value) => Math.log(Math.min(Math.max(value, low), high)));
  const metered = Math.log2(MIDDLE_GREY) - logs.reduce((a, b) => a + b, 0) / logs.length / Math.LN2;
  let exposure = Math.max(Math.min(metered, Math.log2(1.5 / bright)), metered - 2);
  const [median, top] = [percentile(all, 50) * 2 ** exposure, percentile(all, 95) * 2 ** exposure];
  if (top > 0) exposure += Math.max(0, Math.min(Math.log2(0.06 / top), Math.log2(1 / Math.max(median, 1e-9))));
  return exposure;
}

function percentile(sorted: number[], percent: number): number {
  const place = ((sorted.length - 1) * percent) / 100;
  const [low, high] = [sorted[Math.floor(place)], sorted[Math.ceil(place)]];
  return low + (place - Math.floor(place)) * (high - low);
}

export function isWhite(tint: Rgb): boolean {
  return tint.every((value) => value === 1);
}
