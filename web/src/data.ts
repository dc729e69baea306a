// What the page is given, beside it under data/; see datagen/view/content.py.
import type { Rgb } from "./light";

export interface SceneEntry { index: number; kind: string; split: string; views: number; lights: number; objects: number }
export interface Dataset { address: string; scenes: SceneEntry[] }
export interface Light { name: string; kind: string; about: string; kelvin: number | null; colour: Rgb }
export interface Condition { name: string; gains: Record<string, Rgb>; exposure_ev: number }
export interface Body { name: string; category: string; material: string }
export interface Scene {
  index: number; kind: string; split: string; renderer: string; lights: Light[]; objects: string[]; bodies: Body[];
  conditions: Condition[]; views: number; width: number; height: number; start: { scene: string; object: string };
}
interface ViewAbout {
  width: number; height: number; scale: number[]; depth: [number, number];
  objects: { name: string; box: [number, number, number, number]; coverage: number }[]; bytes: Record<string, number>;
}
/** Layers without the object, and in a box (left, top, width, height) its own and how much it covers; half floats. */
export interface ObjectLayers { without: Uint16Array; foreground: Uint16Array; coverage: Uint16Array; box: [number, number, number, number] }
export interface Geometry { depth: Float32Array; normal: Uint16Array; albedo: Uint16Array; ids: Uint16Array }

/** All that is loaded of a view; `all` holds half floats, light by light, row by row, RGB. */
export class View {
  geometry: Geometry | null = null;
  readonly objects = new Map<string, ObjectLayers>();
  private readonly loading = new Map<string, Promise<unknown>>();
  constructor(readonly folder: string, readonly about: ViewAbout, readonly all: Uint16Array) {}

  get bytes(): number {
    return this.about.bytes["all.gz"] * (1 + this.objects.size);
  }

  /** Load an object's layers; those of no object (`""`) are those of the scene. */
  object(name: string): Promise<ObjectLayers> {
    return this.once(`object ${name}`, async () => {
      if (!name) {
        const none: ObjectLayers = { without: this.all, foreground: new Uint16Array(), coverage: new Uint16Array(), box: [0, 0, 0, 0] };
        this.objects.set(name, none);
        return none;
      }
      const found = this.about.objects.find((each) => each.name === name);
      if (!found) throw new Error(`view.json of ${this.folder} names no object ${name}`);
      const file = `object_${name}.gz`;
      const values = new Uint16Array(await unpacked(`${this.folder}/${file}`, this.about.bytes[file]));
      const count = this.all.length;
      const without = values.subarray(0, count);
      for (let i = 0; i < count; i += 1) without[i] ^= this.all[i];
      const covered = found.box[2] * found.box[3];
      const layers = { without, foreground: values.subarray(count, values.length - covered), coverage: values.subarray(values.length - covered), box: found.box };
      this.objects.set(name, layers);
      return layers;
    });
  }

  shapes(): Promise<Geometry> {
    return this.once("geometry", async () => {
      const pixels = this.about.width * this.about.height;
      const buffer = await unpacked(`${this.folder}/geometry.gz`, this.about.bytes["geometry.gz"]);
      const halves = new Uint16Array(buffer, 4 * pixels);
      this.geometry = {
        depth: new Float32Array(buffer, 0, pixels), normal: halves.subarray(0, 3 * pixels),
        albedo: halves.subarray(3 * pixels, 6 * pixels), ids: halves.subarray(6 * pixels),
      };
      return this.geometry;
    });
  }

  /** Load once; what failed is tried again when it is asked for again. */
  private once<T>(name: string, load: () => Promise<T>): Promise<T> {
    let found = this.loading.get(name) as Promise<T> | undefined;
    if (!found) {
      found = load();
      this.loading.set(name, found);
      found.catch(() => this.loading.delete(name));
    }
    return found;
  }
}

/** Views that are in memory, those used last at the end. */
const kept = new Map<string, Promise<View>>();
const MOST_BYTES = 192e6;

export function sceneFolder(index: number): string {
  return `data/scenes/${String(index).padStart(6, "0")}`;
}

export function loadView(scene: number, number: number): Promise<View> {
  const folder = `${sceneFolder(scene)}/views/${String(number).padStart(2, "0")}`;
  const found = kept.get(folder) ?? openView(folder);
  kept.delete(folder);
  kept.set(folder, found);
  found.then(
    (view) => [...kept.keys()].slice(0, -Math.max(2, Math.floor(MOST_BYTES / view.bytes))).forEach((old) => kept.delete(old)),
    () => kept.delete(folder),
  );
  return found;
}

async function openView(folder: string): Promise<View> {
  const about = await loadJson<ViewAbout>(`${folder}/view.json`);
  return new View(folder, about, new Uint16Array(await unpacked(`${folder}/all.gz`, about.bytes["all.gz"])));
}

export async function loadJson<T>(path: string): Promise<T> {
  return (await fetched(path)).json();
}

/** Fetch a file of arrays. A server that unpacks gzip on the way is told by the length. */
async function unpacked(path: string, bytes: number): Promise<ArrayBuffer> {
  const content = await (await fetched(path)).arrayBuffer();
  if (content.byteLength === bytes) return content;
  try {
    const unzipped = await new Response(new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
    if (unzipped.byteLength === bytes) return unzipped;
  } catch {
    // told below
  }
  throw new Error(`${path} is damaged: it is not the ${bytes} bytes in gzip that view.json states`);
}

async function fetched(path: string): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path);
  } catch {
    throw new Error(
      location.protocol === "file:"
        ? "A page that is opened as a file may not read data. Serve its folder: python3 -m http.server --directory FOLDER"
        : `${path} cannot be reached. Is the server still running?`,
    );
  }
  if (answer.ok) return answer;
  const kind = answer.headers.get("Content-Type") ?? "";
  throw new Error(kind.startsWith("text/plain") ? await answer.text() : `${path} cannot be loaded (${answer.status})`);
}
