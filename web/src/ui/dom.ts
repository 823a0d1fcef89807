// Small helpers for making parts of the page.

type Attributes = Readonly<Record<string, string | number | boolean | null | undefined>>;

function set(node: Element, attributes: Attributes): void {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) node.setAttribute(name, "");
    else if (value !== null && value !== undefined && value !== false) node.setAttribute(name, String(value));
  }
}

/** An element with attributes (true: present without a value) and children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const node = document.createElement(tag);
  set(node, attributes);
  node.append(...children);
  return node;
}

const SVG = "http://www.w3.org/2000/svg";

/** An icon of 24 × 24 units: its outlines, in the colour of the text. Hidden from those who listen. */
export function icon(d: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  set(svg, { viewBox: "0 0 24 24", "aria-hidden": "true" });
  const path = document.createElementNS(SVG, "path");
  set(path, { d });
  svg.append(path);
  return svg;
}

/** Of what is not seen before there is a picture, or something went wrong. */
export const OTHERS = {
  next: "M9.5 6l6 6-6 6",
  back: "M14.5 6l-6 6 6 6",
  close: "M6.5 6.5l11 11M17.5 6.5l-11 11",
  check: "M5.5 12.5l4.2 4.2L18.5 8",
  warn: "M12 4 3 19.5h18zM12 10v4.5M12 17v.2",
  offline:
    "M4 10a12 12 0 0 1 4-2.6M20 10a12 12 0 0 0-7-3.4M7.5 13.5a7 7 0 0 1 3-1.6M16.5 13.5a7 7 0 0 0-1.5-1M12 17.5v.2M4.5 4.5l15 15",
  browser: "M4 6h16v12H4zM4 9.5h16M6.8 7.8v.1",
  lock: "M7 11h10v8H7zM9 11V8.5a3 3 0 0 1 6 0V11",
  file: "M7 4h7l4 4v12H7zM14 4v4h4M10.5 12.5l4 4M14.5 12.5l-4 4",
};

/** Outlines, drawn with a round pen; those of FILLED are filled. */
export const ICONS = {
  play: "M8 5.5v13l10.5-6.5z",
  pause: "M8.5 6v12M15.5 6v12",
  sound: "M4 9.5v5h3.5L12 18.5v-13L7.5 9.5zM15.5 9a4.2 4.2 0 0 1 0 6M18 6.5a8 8 0 0 1 0 11",
  mute: "M4 9.5v5h3.5L12 18.5v-13L7.5 9.5zM16 9.5l5 5M21 9.5l-5 5",
  again: "M5 12a7 7 0 1 0 2.2-5.1M5 4.5V8h3.5",
  loop:
    "M7 7h8.5a3.5 3.5 0 0 1 3.5 3.5V12M17 17H8.5A3.5 3.5 0 0 1 5 13.5V12M9.5 4.5 7 7l2.5 2.5" +
    "M14.5 14.5 17 17l-2.5 2.5",
  home: "M12 9.5a2.5 2.5 0 1 0 0 5 2.5 2.5 0 0 0 0-5zM12 3.5v3M12 17.5v3M3.5 12h3M17.5 12h3",
  bounded: "M12 4a8 8 0 1 0 0 16 8 8 0 0 0 0-16zM12 10a2 2 0 1 0 0 4 2 2 0 0 0 0-4z",
  free: "M12 5v14M5 12h14M9.5 7 12 4.5 14.5 7M9.5 17l2.5 2.5 2.5-2.5M7 9.5 4.5 12 7 14.5M17 9.5 19.5 12 17 14.5",
  link:
    "M10 14a4 4 0 0 0 5.7 0l2.6-2.6a4 4 0 0 0-5.7-5.7l-1.1 1.1M14 10a4 4 0 0 0-5.7 0l-2.6 2.6" +
    "a4 4 0 0 0 5.7 5.7l1.1-1.1",
  info: "M5 19v-5M10 19V9M15 19v-7M20 19V5",
  settings:
    "M5 8h8M17 8h2M5 16h2M11 16h8M15 5.8a2.2 2.2 0 1 0 0 4.4 2.2 2.2 0 0 0 0-4.4zM9 13.8a2.2 2.2 0 1 0 0 4.4 2.2 2.2 0 0 0 0-4.4z",
  full: "M9 5H5v4M15 5h4v4M9 19H5v-4M15 19h4v-4",
  small: "M5 9h4V5M19 9h-4V5M5 15h4v4M19 15h-4v4",
  split: "M4 6h16v12H4zM12 3.5v17",
  over: "M7.5 4.5v13M4 14l3.5 3.5L11 14M16.5 19.5v-13M13 10l3.5-3.5L20 10",
  vr: "M3 8h18v9h-6l-2-3h-2l-2 3H3z",
} as const;

/** A round button with an icon; its name is what is said and shown as a tooltip. */
export function iconButton(outlines: string, label: string, attributes: Attributes = {}): HTMLButtonElement {
  return make("button", { type: "button", "aria-label": label, "data-tip": label, ...attributes }, icon(outlines));
}

export function relabel(button: HTMLButtonElement, name: keyof typeof ICONS, label: string): void {
  if (button.dataset.icon === name && button.ariaLabel === label) return;
  button.dataset.icon = name;
  button.ariaLabel = label;
  button.dataset.tip = label;
  button.replaceChildren(icon(ICONS[name]));
}

/** Text of a node, written only where it differs: writing costs a layout. */
export function write(node: Node, text: string): void {
  if (node.textContent !== text) node.textContent = text;
}
