// What opens over the page: the scenes, the file of a lighting, help.
import { type Dataset, type Scene, sceneFolder } from "./data";
import { h, icon, segments } from "./dom";
import { conditionOf, sideLit, type Side, type State, storedAs } from "./state";

function opened(title: string, ...children: (Node | string)[]): HTMLDialogElement {
  const close = h("button", { class: "quiet", "aria-label": "Close", onclick: () => dialog.close() }, icon("close"));
  const dialog = h("dialog", { "aria-label": title, onclose: () => dialog.remove(), onclick: (event: Event) => { if (event.target === dialog) dialog.close(); } }, h("div", { class: "sheet" }, h("div", { class: "line" }, h("h2", { tabindex: -1, autofocus: true }, title), close), ...children));
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}

function counted(count: number, what: string): string {
  return `${count} ${what}${count === 1 ? "" : "s"}`;
}

export function showScenes(dataset: Dataset, current: number, chosen: (index: number) => void): void {
  const cards = dataset.scenes.map(({ index, kind, lights, objects, views }) =>
    h("button", { class: "card", "aria-current": index === current && "true", onclick: () => { dialog.close(); chosen(index); } },
      h("img", { src: `${sceneFolder(index)}/preview.png`, alt: "", loading: "lazy" }),
      h("strong", {}, `Scene ${index}`), h("span", {}, [kind, counted(lights, "light"), counted(objects, "object"), counted(views, "view")].join(" · "))));
  const dialog = opened(counted(dataset.scenes.length, "scene"), h("div", { class: "cards" }, ...cards));
}

export function showSave(state: State, scene: Scene, address: string, told: (text: string) => void): void {
  let side: Side = state.linked || !state.object ? "scene" : state.edits;
  const name = h("input", { type: "text", required: true, pattern: "[a-z][a-z0-9_]{0,39}", spellcheck: "false", autocomplete: "off", "aria-describedby": "name-rule", oninput: () => show() });
  const [text, command] = [h("pre", { tabindex: "0", "aria-label": "The file" }), h("pre", { tabindex: "0", "aria-label": "The command" })];
  const before = h("p", { class: "hint" });
  const save = h("button", { class: "main" }, icon("save"), "Save the file");
  const content = () => `${JSON.stringify(conditionOf(sideLit(state, side), scene, name.value), null, 1).replace(/\[[^\]]*\]/g, (gain) => gain.replace(/\s+/g, "").replaceAll(",", ", "))}\n`;
  const show = () => {
    save.disabled = !name.validity.valid;
    text.textContent = content();
    const around = storedAs(sideLit(state, "scene"), scene)?.name;
    const lit = side === "scene" ? `--condition ${name.value}.json` : `--object ${state.object} --condition ${around ?? "scene.json"} --insert-condition ${name.value}.json`;
    before.textContent = side === "scene" || around ? "With it, from a terminal:" : "With it, and the lighting of the scene saved as scene.json, from a terminal:";
    const quoted = /^[\w@%+=:,./-]+$/.test(address) ? address : `'${address.replaceAll("'", "'\\''")}'`;
    command.textContent = `multilight mix ${quoted} --scene ${state.scene} --view ${state.view} ${lit} --out ${name.value}.png`;
  };
  const choose = (chosen: Side) => {
    side = chosen;
    name.value = storedAs(sideLit(state, side), scene)?.name ?? "mixed";
    bar.show(side);
    show();
  };
  const bar = segments<Side>("saved", "Which lighting", [["scene", "The lighting of the scene", "Scene"], ["object", "The lighting of the object", "Object"]], choose);
  const form = h("form", { method: "dialog", onsubmit: (event: Event) => {
    event.preventDefault();
    const link = h("a", { download: `${name.value}.json`, href: URL.createObjectURL(new Blob([content()], { type: "application/json" })) });
    link.click();
    URL.revokeObjectURL(link.href);
    dialog.close();
    told(`${name.value}.json is saved`);
  } }, state.object && bar, h("label", { class: "field" }, h("span", {}, "Name"), name, h("span", { class: "hint", id: "name-rule" }, "lower-case letters, digits and _, a letter first")), text, before, command, save);
  const dialog = opened("Save the lighting", form);
  choose(side);
}

const KEYS: [string, string][] = [
  ["Tap, click", "on a picture: read that pixel"], ["Drag, swipe", "on a picture: turn through the views; on the divider: move it"],
  ["← →", "turn through the views; on the divider, move it"], ["1 … 9", "turn a light on or off"], ["Shift + 1 … 9", "only that light (solo)"],
  ["O", "change the lighting of the scene, or of the object"], ["L", "under a divider, side by side, all pictures"], ["Enter", "on a picture: read the pixel in its middle; Shift + arrows move it, Escape ends"],
  ["?", "this help"],
];

export function showHelp(note: string): void {
  opened("Light adds up",
    h("p", {}, "Every light of the scene was rendered once, by itself. What you see is their weighted sum, made here: nothing is rendered, and nothing leaves this machine."),
    h("p", {}, "Give the object another lighting than the scene, and the composite goes wrong: the object keeps the light that it came with. The target is the truth, the object really standing there. The effect is what it adds to and takes from the light around it."),
    h("dl", { class: "keys" }, ...KEYS.flatMap(([key, what]) => [h("dt", {}, key), h("dd", {}, what)])),
    h("p", { class: "hint" }, note));
}
