// The light mixer: loads a scene, keeps its state in the address, paints when something changes.
import "./style.css";
import { type Dataset, loadJson, loadView, type Scene, sceneFolder } from "./data";
import { showHelp, showSave, showScenes } from "./dialogs";
import { h, icon, slug } from "./dom";
import { GpuPainter } from "./gpu";
import { CpuPainter, type Painter } from "./paint";
import { gains, Panel } from "./panel";
import { type Shown, Stage } from "./stage";
import { fromHash, LAYOUTS, lightingOf, sideLit, type State, toHash } from "./state";

interface Open { scene: Scene; state: State; stage: Stage; panel: Panel }

const title = h("span", {});
const objects = h("select", { "aria-label": "Object", onchange: () => { if (open) { open.state.object = objects.value; change(); } } });
const button = (name: Parameters<typeof icon>[0], label: string, onclick: () => void) => h("button", { class: "quiet", "aria-label": label, title: label, onclick }, icon(name));
const steps = [button("back", "Scene before", () => stepScene(-1)), button("next", "Next scene", () => stepScene(1))];
const of = h("span", { class: "of" }, "with");
const scenes = h("button", { class: "text strong", title: "All scenes", onclick: () => dataset && showScenes(dataset, open?.state.scene ?? -1, (index) => void openScene(index, "")) }, title);
const main = h("main", {});
const toast = h("div", { class: "toast", role: "status" });
const alarm = h("div", { class: "alarm", role: "alert", hidden: true });
let dataset: Dataset | null = null;
let open: Open | null = null;
let shown: (Shown & { key: string }) | null = null;
let asked = "";
let failed = "";
let frame = 0;
let written = 0;
let address = location.hash;
let painter: Painter = makePainter();

function makePainter(): Painter {
  try {
    const made = new GpuPainter(useProcessor);
    document.documentElement.dataset.painter = "gpu";
    return made;
  } catch {
    document.documentElement.dataset.painter = "cpu";
    return new CpuPainter();
  }
}

function useProcessor(): void {
  painter = new CpuPainter();
  document.documentElement.dataset.painter = "cpu";
  change();
}

/** Paint at the next frame; until that is done, `data-shown` is not there. */
function change(): void {
  delete document.body.dataset.shown;
  if (!frame) frame = requestAnimationFrame(render);
}

function render(): void {
  frame = 0;
  if (!open) return;
  const { state, scene, stage, panel } = open;
  stage.sync();
  panel.sync();
  objects.value = state.object;
  const key = `${state.scene}/${state.view}/${state.object}`;
  if (key !== shown?.key && key !== asked && key !== failed) void load(key);
  main.setAttribute("aria-busy", String(key !== shown?.key));
  if (!shown || !shown.key.startsWith(`${state.scene}/`)) return;
  const base = sideLit(state, "scene");
  const insert = sideLit(state, "object");
  const { scale } = shown.view.about;
  const lit = { base: gains(base, 2 ** base.ev, scale), insert: gains(insert, 2 ** insert.ev, scale), curve: state.curve };
  try {
    painter.take(shown.view, shown.object);
  } catch {
    useProcessor();
    return;
  }
  if (stage.wantsGeometry && !shown.view.geometry) {
    const wanted = shown;
    shown.view.shapes().then(change, (error: Error) => { if (failed !== wanted.key) { failed = wanted.key; fail(error); } });
  }
  stage.paint(shown, painter, lit);
  if (key !== shown.key) return;
  panel.show(shown.view);
  clearTimeout(written);
  const hash = toHash(state, scene);
  written = window.setTimeout(() => write(hash), 150);
  if (!stage.wantsGeometry || shown.view.geometry) document.body.dataset.shown = hash;
}

/** Put the state into the address, unless somebody has just changed that. */
function write(hash: string): void {
  if (location.hash !== address) return;
  history.replaceState(null, "", `#${hash}`);
  address = location.hash;
}

async function load(key: string): Promise<void> {
  if (!open) return;
  const { state } = open;
  const { scene, view: number, object } = state;
  asked = key;
  try {
    const view = await loadView(scene, number);
    await view.object(object);
    if (asked !== key) return;
    shown = { view, object, key };
    failed = "";
    alarm.hidden = true;
    const next = number + 1 < open.scene.views ? number + 1 : 0;
    loadView(scene, next).then((ahead) => ahead.object(object)).catch(() => undefined); // told when it is asked for
  } catch (error) {
    if (asked !== key) return;
    failed = key;
    fail(error as Error);
  }
  asked = "";
  change();
}

function fail(error: Error): void {
  alarm.hidden = false;
  alarm.replaceChildren(h("p", {}, error.message), h("button", { onclick: () => { alarm.hidden = true; failed = ""; if (open) change(); else void begin(); } }, "Try again"));
}

async function openScene(index: number, hash: string): Promise<void> {
  clearTimeout(written); // what was shown before must not take the place of what is asked for
  delete document.body.dataset.shown;
  try {
    const scene = await loadJson<Scene>(`${sceneFolder(index)}/scene.json`);
    const light = (name: string) => lightingOf(scene.conditions.find((condition) => condition.name === name) ?? scene.conditions[0], scene);
    const old = open?.state;
    const state: State = {
      scene: index, view: 0, object: scene.objects[0] ?? "", left: "composite", right: "target", layout: "divide", divider: 0.5, curve: "soft", edits: "object",
      linked: false, pick: null, lightings: { scene: light(scene.start.scene), object: light(scene.start.object) },
      ...(old && { left: old.left, right: old.right, layout: old.layout, curve: old.curve }),
    };
    const words = new URLSearchParams(hash);
    if (hash) fromHash(hash, state, scene);
    if (!scene.objects.includes(words.get("object") ?? "")) await chooseObject(state, !words.has("divider"));
    const panel = new Panel(state, scene, change);
    const stage = new Stage(state, scene, change);
    open = { scene, state, stage, panel };
    failed = "";
    alarm.hidden = true;
    title.textContent = `Scene ${index} · ${scene.kind}`;
    document.title = `Scene ${index} · Light mixer`;
    objects.replaceChildren(...scene.objects.map((name) => h("option", { value: name }, slug(name))));
    objects.hidden = of.hidden = !scene.objects.length;
    main.replaceChildren(stage.element, panel.element);
    stage.element.append(alarm);
  } catch (error) {
    if (!open) main.replaceChildren(alarm);
    fail(error as Error);
  }
  change();
}

/** Begin with the object that covers most of the view, under the divider; what cannot be read is told later. */
async function chooseObject(state: State, divide: boolean): Promise<void> {
  try {
    const { about } = await loadView(state.scene, state.view);
    const { name, box: [left, , wide] } = about.objects.reduce((best, each) => (each.coverage > best.coverage ? each : best));
    state.object = name;
    if (divide) state.divider = (left + wide / 2) / about.width;
  } catch {
    if (divide) state.divider = 0.5;
  }
}

function stepScene(by: number): void {
  if (!dataset) return;
  const at = dataset.scenes.findIndex(({ index }) => index === open?.state.scene);
  const to = dataset.scenes[(at + by + dataset.scenes.length) % dataset.scenes.length];
  void openScene(to.index, "");
}

function tell(text: string): void {
  toast.textContent = text;
  toast.classList.add("there");
  setTimeout(() => toast.classList.remove("there"), 2500);
}

async function copyLink(): Promise<void> {
  if (open) write(toHash(open.state, open.scene));
  await navigator.clipboard.writeText(location.href).then(() => tell("The link to this state is copied"), () => tell("The address bar holds the link to this state"));
}

function help(): void {
  showHelp(painter instanceof GpuPainter ? "Mixed on the graphics card, in half floats." : "Mixed by the processor: there is no graphics card here that WebGL2 can use.");
}

function key(event: KeyboardEvent): void {
  const target = event.target as HTMLElement;
  if (!open || document.querySelector("dialog") || event.ctrlKey || event.metaKey || event.altKey || target.matches("select, input:is([type=text], [type=color])") || (event.key.startsWith("Arrow") && target.matches("input"))) return;
  const { state, panel, stage } = open;
  const digit = /^Digit([1-9])$/.exec(event.code);
  if (digit) panel.toggle(Number(digit[1]) - 1, event.shiftKey ? "solo" : "on");
  else if (event.key === "ArrowLeft" || event.key === "ArrowRight") stage.turnBy(event.key === "ArrowLeft" ? -1 : 1);
  else if (event.key === "o") { state.edits = state.edits === "scene" ? "object" : "scene"; state.linked &&= state.edits === "scene"; }
  else if (event.key === "l") state.layout = LAYOUTS[(LAYOUTS.indexOf(state.layout) + 1) % LAYOUTS.length];
  else if (event.key === "?") help();
  else return;
  event.preventDefault();
  change();
}

async function begin(): Promise<void> {
  try {
    dataset = await loadJson<Dataset>("data/dataset.json");
  } catch (error) {
    main.replaceChildren(alarm);
    fail(error as Error);
    return;
  }
  steps.forEach((step) => (step.hidden = dataset?.scenes.length === 1));
  await follow();
}

/** Show what the address says. */
async function follow(): Promise<void> {
  clearTimeout(written);
  address = location.hash;
  const hash = address.slice(1);
  if (!dataset || hash === document.body.dataset.shown) return;
  const named = Number(new URLSearchParams(hash).get("scene") ?? NaN);
  const index = dataset.scenes.find((scene) => scene.index === named)?.index ?? dataset.scenes[0].index;
  if (named >= 0 && named !== index) tell(`There is no scene ${named} here: this is scene ${index}`);
  if (open && open.state.scene === index && hash) {
    fromHash(hash, open.state, open.scene);
    change();
  } else await openScene(index, hash);
}

document.body.append(
  h("header", {},
    h("h1", {}, h("span", { class: "brand", "aria-hidden": "true" }, h("i", {}), h("i", {}), h("i", {})), h("span", {}, "Light mixer")),
    h("div", { class: "where" }, steps[0], scenes, steps[1], of, objects),
    h("div", { class: "actions" }, button("save", "Save the lighting", () => open && showSave(open.state, open.scene, dataset?.address ?? "", tell)), button("link", "Copy the link", () => void copyLink()), button("help", "Help", help))),
  main, toast);
document.addEventListener("keydown", key);
window.addEventListener("hashchange", () => void follow());
void begin();
