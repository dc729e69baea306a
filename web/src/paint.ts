// Pictures without a graphics card: what is stored of a view, thumbnails, single pixels, and all else where need be.
import type { Geometry, ObjectLayers, View } from "./data";
import { type Curve, display, encode, type Rgb } from "./light";
import type { Pane } from "./state";

/** Gains of the scene's and the object's lighting, exposure and layers' scale included: (L, 3) each. */
export interface Lit { base: Float32Array; insert: Float32Array; curve: Curve }
export interface Painter {
  /** Take the layers that are painted from now on. */
  take(view: View, object: string): void;
  /** Paint a lit pane at the view's own size. */
  paint(pane: Pane, lit: Lit): CanvasImageSource;
}

/** The value of each half float by its bits. */
export const HALF = Float32Array.from({ length: 1 << 16 }, (_, bits) => {
  const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
  const size = exponent === 0 ? fraction * 2 ** -24 : exponent === 31 ? (fraction ? NaN : Infinity) : (1 + fraction / 1024) * 2 ** (exponent - 15);
  return bits >> 15 ? -size : size;
});

/** The linear radiance of one pixel of a lit pane, as `multilight mix` writes it to EXR. */
export function radianceAt(pane: Pane, view: View, object: ObjectLayers, lit: Lit, x: number, y: number): Rgb {
  const { width, height } = view.about;
  const at = 3 * (y * width + x);
  const target = summed(view.all, 3 * width * height, at, lit.base);
  if (pane === "target") return target;
  const background = summed(object.without, 3 * width * height, at, lit.base);
  if (pane === "background") return background;
  if (pane === "effect") return [target[0] - background[0], target[1] - background[1], target[2] - background[2]];
  const [left, top, wide, high] = object.box;
  const [column, row] = [x - left, y - top];
  if (column < 0 || column >= wide || row < 0 || row >= high) return background;
  const own = summed(object.foreground, 3 * wide * high, 3 * (row * wide + column), lit.insert);
  const free = 1 - HALF[object.coverage[row * wide + column]];
  return [own[0] + free * background[0], own[1] + free * background[1], own[2] + free * background[2]];
}

function summed(layers: Uint16Array, size: number, at: number, gains: Float32Array): Rgb {
  const sum: Rgb = [0, 0, 0];
  for (let i = 0, from = at; i < gains.length; i += 3, from += size) {
    sum[0] += gains[i] * HALF[layers[from]];
    sum[1] += gains[i + 1] * HALF[layers[from + 1]];
    sum[2] += gains[i + 2] * HALF[layers[from + 2]];
  }
  return sum;
}

/** Paints without a graphics card, light by light, so that memory is read in order. */
export class CpuPainter implements Painter {
  private readonly canvas = document.createElement("canvas");
  private view!: View;
  private object!: ObjectLayers;

  take(view: View, object: string): void {
    this.view = view;
    this.object = view.objects.get(object) as ObjectLayers;
  }

  paint(pane: Pane, lit: Lit): CanvasImageSource {
    const { width, height } = this.view.about;
    const picture = this.mixed(pane, lit);
    const image = new ImageData(width, height);
    for (let from = 0, to = 0; from < picture.length; from += 3, to += 4) {
      const [r, g, b] = [picture[from], picture[from + 1], picture[from + 2]];
      if (pane !== "effect") display(lit.curve, r, g, b, image.data, to);
      else image.data.set([signed(r), signed(g), signed(b), 255], to);
    }
    Object.assign(this.canvas, { width, height });
    (this.canvas.getContext("2d") as CanvasRenderingContext2D).putImageData(image, 0, 0);
    return this.canvas;
  }

  private mixed(pane: Pane, lit: Lit): Float32Array {
    const { all } = this.view;
    const { without, foreground, coverage, box: [left, top, wide, high] } = this.object;
    const picture = mixedHalves(pane === "target" || pane === "effect" ? all : without, lit.base);
    if (pane === "effect") {
      const background = mixedHalves(without, lit.base);
      for (let at = 0; at < picture.length; at += 1) picture[at] -= background[at];
    } else if (pane === "composite") {
      const own = mixedHalves(foreground, lit.insert);
      for (let row = 0, from = 0; row < high; row += 1) {
        let to = 3 * ((top + row) * this.view.about.width + left);
        for (let column = 0; column < wide; column += 1) {
          const free = 1 - HALF[coverage[row * wide + column]];
          for (let c = 0; c < 3; c += 1, from += 1, to += 1) picture[to] = own[from] + free * picture[to];
        }
      }
    }
    return picture;
  }
}

function mixedHalves(layers: Uint16Array, gains: Float32Array): Float32Array {
  const size = (3 * layers.length) / gains.length;
  const sum = new Float32Array(size);
  for (let from = 0, i = 0; from < layers.length; from += size, i += 3) {
    const [r, g, b] = [gains[i], gains[i + 1], gains[i + 2]];
    if (!r && !g && !b) continue;
    for (let at = 0; at < size; at += 3) {
      sum[at] += r * HALF[layers[from + at]];
      sum[at + 1] += g * HALF[layers[from + at + 1]];
      sum[at + 2] += b * HALF[layers[from + at + 2]];
    }
  }
  return sum;
}

function signed(value: number): number {
  return (Math.tanh(1.5 * value) * 0.5 + 0.5) * 255;
}

/** What is stored of a view as a picture: `datagen/tuples/pictures.py`. */
export function storedPicture(pane: Pane, view: View, geometry: Geometry): ImageData {
  const { width, height, depth: [near, far] } = view.about;
  const image = new ImageData(width, height);
  for (let i = 0; i < width * height; i += 1) {
    const triple = (values: Uint16Array, shown: (value: number) => number): Rgb =>
      [0, 1, 2].map((c) => 255 * shown(HALF[values[3 * i + c]])) as Rgb;
    let colour: Rgb;
    if (pane === "depth") {
      const z = geometry.depth[i];
      const grey = z > 0 ? Math.floor(255 * Math.min(Math.max(1 - (0.85 * (z - near)) / Math.max(far - near, 1e-6), 0.1), 1)) : 0;
      colour = [grey, grey, grey];
    } else if (pane === "normal") colour = triple(geometry.normal, (value) => 0.5 + 0.5 * value);
    else if (pane === "albedo") colour = triple(geometry.albedo, encode);
    else colour = idColour(geometry.ids[i]);
    image.data.set([...colour, 255], 4 * i);
  }
  return image;
}

function idColour(id: number): Rgb {
  if (id === 0) return [0, 0, 0];
  const [hue, saturation, value] = [(id * 0.618034) % 1, [0.9, 0.5][id % 2], [1, 0.7][(id >> 1) % 2]];
  const channel = (n: number): number => {
    const k = (n + hue * 6) % 6;
    return 255 * (value - value * saturation * Math.max(0, Math.min(k, 4 - k, 1)));
  };
  return [channel(5), channel(3), channel(1)];
}

/** Layers of a view shrunk by averaging blocks, so that light still adds: `thumbnail` of `datagen/tuples/exposure.py`. */
export interface Small { width: number; height: number; layers: Float32Array }

export function shrunk(view: View, side: number): Small {
  const { width, height, scale } = view.about;
  const [stepX, stepY] = [Math.max(1, Math.floor(width / side)), Math.max(1, Math.floor(height / side))];
  const [wide, high] = [Math.floor(width / stepX), Math.floor(height / stepY)];
  const layers = new Float32Array(3 * wide * high * scale.length);
  for (let light = 0, to = 0; light < scale.length; light += 1) {
    const share = scale[light] / (stepX * stepY);
    for (let row = 0; row < high; row += 1) {
      for (let column = 0; column < wide; column += 1, to += 3) {
        for (let y = row * stepY; y < (row + 1) * stepY; y += 1) {
          let from = 3 * ((light * height + y) * width + column * stepX);
          for (let x = 0; x < stepX; x += 1, from += 3) {
            for (let c = 0; c < 3; c += 1) layers[to + c] += share * HALF[view.all[from + c]];
          }
        }
      }
    }
  }
  return { width: wide, height: high, layers };
}

/** Light shrunk layers with gains (L, 3). */
export function mixSmall(small: Small, gains: Float32Array): Float32Array {
  const size = 3 * small.width * small.height;
  const sum = new Float32Array(size);
  for (let from = 0, i = 0; from < small.layers.length; from += size, i += 3) {
    if (!gains[i] && !gains[i + 1] && !gains[i + 2]) continue;
    for (let at = 0; at < size; at += 3) {
      for (let c = 0; c < 3; c += 1) sum[at + c] += gains[i + c] * small.layers[from + at + c];
    }
  }
  return sum;
}
