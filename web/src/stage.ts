// The pictures: panes under a divider, side by side or all at once; dragging, picking, turning through the views.
import type { Geometry, Scene, View } from "./data";
import { h, icon, segments, slider, slug } from "./dom";
import { luminance, MIDDLE_GREY, type Rgb } from "./light";
import { type Lit, type Painter, radianceAt, storedPicture } from "./paint";
import { LIT, type Layout, type Pane, PANES, type State } from "./state";

export const ABOUT: Record<Pane, string> = {
  background: "the scene without the object: no shadow, no reflection, no glow of it",
  composite: "the object, lit by its own lighting, pasted over the background",
  target: "the truth: the object in its place under the scene's lighting",
  effect: "target − background: shadows dark, glow bright, nothing grey",
  depth: "along the optical axis, near bright",
  normal: "directions of the surfaces in world axes",
  albedo: "base colours, without light",
  ids: "a colour for each body",
};
const STEP = 28;
/** Pixels of a drag that turn to the next view, and those within which the divider is grasped or a click stays one. */
const GRASP = 18;
const STILL = 5;

export interface Shown { view: View; object: string }

export class Stage {
  readonly element: HTMLElement;
  private readonly area = h("div", { class: "area" });
  private readonly frames: HTMLElement[] = [];
  private readonly canvases = new Map<HTMLCanvasElement, Pane>();
  private readonly handle: HTMLElement;
  private readonly read = h("p", { class: "read", role: "status" });
  private readonly legend = h("div", { class: "legend", "aria-hidden": "true" }, ...Array.from({ length: 13 }, (_, i) => h("span", { class: `stop stop${i}` }, `${i > 6 ? "+" : i < 6 ? "−" : ""}${Math.abs(i - 6)}`)));
  private readonly selects: HTMLSelectElement[];
  private readonly layouts;
  private readonly turn;
  private readonly turnText = h("output", { class: "value" });
  private readonly stored = new WeakMap<View, Map<Pane, ImageData>>();
  private readonly painted = new WeakMap<HTMLCanvasElement, { wanted: string; shown: Shown; painter: Painter }>();
  private layout: Layout | "" = "";
  private ratio = 0;

  constructor(private readonly state: State, private readonly scene: Scene, private readonly change: () => void) {
    const choose = (side: "left" | "right", label: string) => h("select", { "aria-label": label, onchange: (event: Event) => { state[side] = (event.target as HTMLSelectElement).value as Pane; change(); } }, ...PANES.map((pane) => h("option", { value: pane }, named(pane))));
    this.selects = [choose("left", "Picture on the left"), choose("right", "Picture on the right")];
    this.layouts = segments<Layout>("layout", "Layout", [["divide", "Under a divider", icon("divide")], ["pair", "Side by side", icon("pair")], ["all", "All pictures", icon("grid")]], (layout) => { state.layout = layout; change(); });
    this.turn = slider("View", 0, scene.views - 1, 1, (view) => { state.view = view; change(); }, { class: "views-at" });
    this.handle = h("div", { class: "handle", role: "slider", tabindex: "0", "aria-label": "Divider", "aria-orientation": "horizontal", "aria-valuemin": "0", "aria-valuemax": "100", onkeydown: (event: KeyboardEvent) => this.moveDivider(event) }, h("span", { class: "grip" }));
    const step = (by: number, label: string, name: "back" | "next") => h("button", { class: "quiet", "aria-label": label, title: label, onclick: () => this.turnBy(by) }, icon(name));
    this.element = h("section", { class: "stage", "aria-label": "Pictures" },
      h("div", { class: "bar" }, this.selects[0], this.layouts, this.selects[1]),
      this.area,
      h("div", { class: "bar views", hidden: scene.views === 1 }, step(-1, "View before", "back"), this.turn, step(1, "Next view", "next"), this.turnText),
      this.legend, this.read);
  }

  turnBy(by: number): void {
    this.state.view = (this.state.view + by + this.scene.views) % this.scene.views;
    this.change();
  }

  /** Show the controls as the state is. */
  sync(): void {
    const { state } = this;
    this.selects[0].value = state.left;
    this.selects[1].value = state.right;
    this.selects.forEach((select) => { select.disabled = state.layout === "all"; select.title = ABOUT[select.value as Pane]; });
    this.layouts.show(state.layout);
    this.turn.show(state.view, `View ${state.view}, of ${this.scene.views}`);
    this.turnText.value = `View ${state.view}`;
    this.legend.hidden = state.curve !== "stops";
    this.element.dataset.layout = state.layout;
    if (this.layout !== state.layout) this.build();
    this.handle.style.left = `${100 * state.divider}%`;
    this.handle.setAttribute("aria-valuenow", String(Math.round(100 * state.divider)));
    this.handle.setAttribute("aria-valuetext", `${named(state.left)} on the left ${Math.round(100 * state.divider)} percent`);
    const panes = state.layout === "all" ? PANES : [state.left, state.right];
    [...this.canvases.keys()].forEach((canvas, i) => {
      this.canvases.set(canvas, panes[i]);
      canvas.dataset.pane = panes[i];
      canvas.setAttribute("aria-label", `${named(panes[i])}: ${ABOUT[panes[i]]}`);
      if (state.layout === "divide") canvas.style.clipPath = i ? `inset(0 0 0 ${100 * state.divider}%)` : `inset(0 ${100 - 100 * state.divider}% 0 0)`;
    });
  }

  /** Paint the panes that show something else than they should. Geometry that is not loaded yet is painted by a later call. */
  paint(shown: Shown, painter: Painter, lit: Lit): void {
    const { width, height } = shown.view.about;
    if (this.ratio !== width / height) {
      this.ratio = width / height;
      this.area.style.setProperty("--ratio", String(this.ratio));
    }
    for (const [canvas, pane] of this.canvases) {
      const wanted = isLit(pane) ? [pane, lit.curve, lit.base, pane === "composite" ? lit.insert : ""].join() : pane;
      const old = this.painted.get(canvas);
      if (old && old.wanted === wanted && old.shown === shown && old.painter === painter) continue;
      if (!isLit(pane) && !shown.view.geometry) continue;
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      const context = canvas.getContext("2d") as CanvasRenderingContext2D;
      if (isLit(pane)) context.drawImage(painter.paint(pane, lit), 0, 0);
      else if (shown.view.geometry) context.putImageData(this.storedOf(pane, shown.view, shown.view.geometry), 0, 0);
      this.painted.set(canvas, { wanted, shown, painter });
    }
    this.mark(shown, lit);
  }

  /** Whether panes or a pick want what only the geometry tells. */
  get wantsGeometry(): boolean {
    return this.state.pick !== null || [...this.canvases.values()].some((pane) => !isLit(pane));
  }

  private storedOf(pane: Pane, view: View, geometry: Geometry): ImageData {
    const made = this.stored.get(view) ?? new Map<Pane, ImageData>();
    this.stored.set(view, made);
    const picture = made.get(pane) ?? storedPicture(pane, view, geometry);
    made.set(pane, picture);
    return picture;
  }

  /** Make the frames of a layout. */
  private build(): void {
    this.layout = this.state.layout;
    this.canvases.clear();
    this.frames.length = 0;
    const canvas = (pane: Pane) => {
      const made = h("canvas", { role: "img" });
      this.canvases.set(made, pane);
      return made;
    };
    const frame = (...children: Node[]) => {
      const made = h("div", { class: "frame" }, ...children, h("span", { class: "mark", hidden: true }));
      this.listen(made);
      this.frames.push(made);
      return made;
    };
    const figure = (pane: Pane) => h("figure", {}, frame(canvas(pane)), h("figcaption", {}, named(pane)));
    const { state } = this;
    if (this.layout === "divide") this.area.replaceChildren(frame(canvas(state.left), canvas(state.right), this.handle));
    else if (this.layout === "pair") this.area.replaceChildren(frame(canvas(state.left)), frame(canvas(state.right)));
    else this.area.replaceChildren(...PANES.map(figure));
  }

  private listen(frame: HTMLElement): void {
    frame.tabIndex = 0;
    frame.setAttribute("role", "group");
    frame.setAttribute("aria-label", "Picture: arrow keys turn through the views, Enter reads the pixel in the middle, Shift and arrows move it");
    frame.addEventListener("keydown", (event) => this.key(event, frame));
    frame.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      const box = frame.getBoundingClientRect();
      const { state } = this;
      const [startX, startY, startView] = [event.clientX, event.clientY, state.view];
      const divides = this.layout === "divide" && Math.abs(event.clientX - box.left - state.divider * box.width) < GRASP;
      let moved = false;
      frame.setPointerCapture(event.pointerId);
      const move = (now: PointerEvent) => {
        moved ||= Math.hypot(now.clientX - startX, now.clientY - startY) > STILL;
        if (divides) state.divider = Math.min(Math.max((now.clientX - box.left) / box.width, 0), 1);
        else if (moved) state.view = Math.min(Math.max(startView + Math.round((now.clientX - startX) / Math.max(STEP, box.width / 2 / this.scene.views)), 0), this.scene.views - 1);
        else return;
        this.change();
      };
      const end = (now: PointerEvent) => {
        frame.removeEventListener("pointermove", move);
        frame.removeEventListener("pointerup", end);
        frame.removeEventListener("pointercancel", end);
        if (divides || moved || now.type === "pointercancel") return;
        this.pickAt(frame, (now.clientX - box.left) / box.width, (now.clientY - box.top) / box.height);
      };
      frame.addEventListener("pointermove", move);
      frame.addEventListener("pointerup", end);
      frame.addEventListener("pointercancel", end);
    });
  }

  private pickAt(frame: HTMLElement, x: number, y: number): void {
    const { state, scene } = this;
    const panes = [...frame.querySelectorAll("canvas")].map((canvas) => this.canvases.get(canvas) as Pane);
    const pane = panes.length > 1 && x > state.divider ? panes[1] : panes[0];
    state.pick = { x: clamp(Math.floor(x * scene.width), scene.width), y: clamp(Math.floor(y * scene.height), scene.height), pane };
    this.change();
  }

  private key(event: KeyboardEvent, frame: HTMLElement): void {
    if (event.target !== frame) return;
    const { state, scene } = this;
    const [dx, dy] = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] } as Record<string, [number, number]>)[event.key] ?? [0, 0];
    if (event.key === "Enter") this.pickAt(frame, 0.5, 0.5);
    else if (event.key === "Escape") state.pick = null;
    else if (event.shiftKey && state.pick && (dx || dy)) state.pick = { ...state.pick, x: clamp(state.pick.x + dx, scene.width), y: clamp(state.pick.y + dy, scene.height) };
    else return;
    event.preventDefault();
    event.stopPropagation();
    this.change();
  }

  private moveDivider(event: KeyboardEvent): void {
    const by = ({ ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 } as Record<string, number>)[event.key];
    if (by === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    this.state.divider = Math.min(Math.max(this.state.divider + by, 0), 1);
    this.change();
  }

  /** Show where a pixel was picked, and what is known of it. */
  private mark(shown: Shown, lit: Lit): void {
    const { pick } = this.state;
    const { width, height } = shown.view.about;
    for (const frame of this.frames) {
      const mark = frame.querySelector(".mark") as HTMLElement;
      mark.hidden = !pick;
      if (pick) Object.assign(mark.style, { left: `${(100 * (pick.x + 0.5)) / width}%`, top: `${(100 * (pick.y + 0.5)) / height}%` });
    }
    const facts = pick ? this.told(shown, lit) : [h("span", { class: "hint" }, `${this.scene.views > 1 ? "Drag to turn through the views, click" : "Click"} to read a pixel.`)];
    // Put there only where it says something new: screen readers read out what is put there.
    if (this.read.textContent !== facts.map((fact) => fact.textContent).join("")) this.read.replaceChildren(...facts);
  }

  private told({ view, object }: Shown, lit: Lit): Node[] {
    const pick = this.state.pick as NonNullable<State["pick"]>;
    const pane: Pane = isLit(pick.pane) ? pick.pane : "target";
    const layers = view.objects.get(object);
    const fact = (name: string, ...text: (string | Node)[]) => h("span", { class: "fact" }, h("span", { class: "key" }, name), ...text);
    const facts = [fact("pixel", `${pick.x}, ${pick.y}`)];
    if (layers) {
      const rgb = radianceAt(pane, view, layers, lit, pick.x, pick.y);
      const grey = luminance(rgb);
      const stops = pane !== "effect" && grey > 0 ? ` (${signed(Math.log2(grey / MIDDLE_GREY), 1)} EV)` : "";
      facts.push(fact(pane, `${rgb.map((value) => value.toPrecision(3)).join("  ")}${stops}`));
    }
    if (view.geometry) {
      const at = pick.y * view.about.width + pick.x;
      const [depth, id] = [view.geometry.depth[at], view.geometry.ids[at]];
      const body = this.scene.bodies[id - 1];
      facts.push(fact("depth", depth > 0 ? `${depth.toPrecision(4)} m` : "nothing there"));
      if (body) facts.push(fact("object", slug(body.name) === slug(body.category) ? slug(body.name) : `${slug(body.name)} (${slug(body.category)})`), fact("material", body.material));
    }
    return facts;
  }
}

export function named(pane: Pane): string {
  return { ids: "IDs", normal: "Normals" }[pane as string] ?? pane[0].toUpperCase() + pane.slice(1);
}

export function isLit(pane: Pane): boolean {
  return (LIT as readonly Pane[]).includes(pane);
}

export function signed(value: number, digits: number): string {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
}

export function cssOf(rgb: Rgb): string {
  const peak = Math.max(...rgb, 1e-9);
  return `rgb(${rgb.map((value) => Math.round(255 * (value / peak) ** (1 / 2.2))).join(" ")})`;
}

function clamp(value: number, size: number): number {
  return Math.min(Math.max(value, 0), size - 1);
}
