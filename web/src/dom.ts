// Small helpers to make elements.
type Attributes = Record<string, string | number | boolean | ((event: any) => void) | undefined>;
type Child = Node | string;

/** Make an element: functions are listeners (`onclick`), false and undefined attributes are left out. */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, attributes: Attributes = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== undefined) element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children);
  return element;
}

const ICONS = {
  back: "M10 3 5 8l5 5", next: "m6 3 5 5-5 5", grid: "M2.5 2.5h4.5v4.5H2.5zM9 2.5h4.5v4.5H9zM2.5 9h4.5v4.5H2.5zM9 9h4.5v4.5H9z",
  save: "M8 2v7.5M4.8 6.6 8 9.8l3.2-3.2M2.5 11.5v2h11v-2", link: "M6.7 9.3a2.6 2.6 0 0 0 3.7 0l2.3-2.3a2.6 2.6 0 0 0-3.7-3.7l-.9.9M9.3 6.7a2.6 2.6 0 0 0-3.7 0L3.3 9A2.6 2.6 0 0 0 7 12.7l.9-.9",
  help: "M5.9 6a2.1 2.1 0 1 1 3.2 1.8c-.8.5-1.1.9-1.1 1.7M8 12v.1", divide: "M2.5 3h11v10h-11zM8 1.5v13", pair: "M2 3.5h5v9H2zM9 3.5h5v9H9z",
  reset: "M3 8a5 5 0 1 0 1.6-3.7L3 5.8M3 2.6v3.2h3.2", close: "m4 4 8 8M12 4l-8 8", meter: "M3 11.5a5.5 5.5 0 1 1 10 0M8 9.5l2.6-3.4",
};

export function icon(name: keyof typeof ICONS): SVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  svg.classList.add("icon");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}

/** A choice of one: radio buttons that look like one bar. */
export function segments<T extends string>(name: string, label: string, choices: [T, string, Child][], chosen: (value: T) => void): HTMLFieldSetElement & { show(value: T): void } {
  const inputs = choices.map(([value]) => h("input", { type: "radio", name, value, onchange: () => chosen(value) }));
  const parts = choices.map(([, hint, shown], i) => h("label", { title: hint }, inputs[i], h("span", {}, shown, ...(typeof shown === "string" ? [] : [h("span", { class: "hidden" }, hint)]))));
  const bar = h("fieldset", { class: "segments" }, h("legend", { class: "hidden" }, label), ...parts);
  return Object.assign(bar, { show: (value: T) => inputs.forEach((input) => (input.checked = input.value === value)) });
}

/** A slider of its own look; `--at` in its style is where its thumb is, for the track. */
export function slider(label: string, low: number, high: number, step: number, moved: (value: number) => void, attributes: Attributes = {}): HTMLInputElement & { show(value: number, text: string): void } {
  const input = h("input", { type: "range", "aria-label": label, min: low, max: high, step, oninput: () => moved(input.valueAsNumber), ...attributes });
  return Object.assign(input, {
    show(value: number, text: string): void {
      if (Math.abs(input.valueAsNumber - value) > step / 2) input.valueAsNumber = value;
      input.setAttribute("aria-valuetext", text);
      input.style.setProperty("--at", String((Math.min(Math.max(value, low), high) - low) / (high - low || 1)));
    },
  });
}

export function slug(text: string): string {
  return text.replaceAll("_", " ");
}
