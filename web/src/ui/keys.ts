// The keyboard: what each key does.
import type { Desk } from "./desk.ts";
import { iconButton, make, OTHERS } from "./dom.ts";
import type { Push } from "./orbit.ts";

const TURN = 1.1;
const PAN = 0.5;
const ZOOM = 1.0;
const SKIP_S = 5;

const DRIVES: Readonly<Record<string, Push>> = {
  arrowleft: { right: -TURN },
  arrowright: { right: TURN },
  arrowup: { up: TURN },
  arrowdown: { up: -TURN },
  a: { panRight: -PAN },
  d: { panRight: PAN },
  w: { panUp: PAN },
  s: { panUp: -PAN },
  "+": { nearer: ZOOM },
  "=": { nearer: ZOOM },
  "-": { nearer: -ZOOM },
  _: { nearer: -ZOOM },
};

const COMMANDS: Readonly<Record<string, (desk: Desk) => void>> = {
  " ": (desk) => desk.toggle(),
  k: (desk) => desk.toggle(),
  j: (desk) => desk.skip(-SKIP_S),
  l: (desk) => desk.skip(SKIP_S),
  "shift+arrowleft": (desk) => desk.skip(-SKIP_S),
  "shift+arrowright": (desk) => desk.skip(SKIP_S),
  ",": (desk) => desk.frame(-1),
  ".": (desk) => desk.frame(1),
  r: (desk) => desk.home(),
  home: (desk) => desk.home(true),
  b: (desk) => desk.beginHere(),
  o: (desk) => desk.turnOver(),
  c: (desk) => desk.copyLink(),
  f: (desk) => desk.showSubject(),
  enter: (desk) => desk.toggleFull(),
  m: (desk) => desk.toggleSound(),
  i: (desk) => desk.toggleInfo(),
  "?": (desk) => desk.toggleKeys(),
};

/** All of them in words; those of TIMED do nothing to a still. */
const LOOKING =
  "Arrow keys, drag: turn; W A S D, right button: move; + −, wheel, pinch: zoom; F: show all of the subject; " +
  "Double click: turn about what is there; R: back to where you began; B: begin here; Home: back to the first view; " +
  "O: turn over; C: copy a link; I: figures; Enter: full screen; ?: these keys";
const TIMED = "Space, K: play, pause; J L: five seconds back, on; , .: one frame back, on; M: mute; ";

/** For a help text: what people who cannot see buttons want to know. */
export const helpOf = ({ still }: Desk): string => (still ? "" : TIMED) + LOOKING;

/** A card with all keys; `leave` is called when people are done with it. */
export function keysCard(desk: Desk, leave: () => void): HTMLElement {
  const close = iconButton(OTHERS.close, "Close");
  const rows = helpOf(desk)
    .split("; ")
    .map((row) => {
      const [key, what] = row.split(": ");
      return make("div", {}, make("dt", {}, key), make("dd", {}, what));
    });
  const attributes = { class: "card keys", role: "dialog", "aria-label": "Keys", tabindex: -1 };
  const card = make("section", attributes, make("div", { class: "head" }, "Keys", close), make("dl", {}, ...rows));
  close.addEventListener("click", leave);
  card.addEventListener("keydown", ({ key }) => key === "Escape" && leave());
  return card;
}

const own = (target: EventTarget | undefined, key: string): boolean =>
  target instanceof HTMLElement &&
  (target.matches("input, select, textarea") || (target.matches("button") && (key === " " || key === "enter")));

export function listenToKeys(area: HTMLElement, desk: Desk, signal: AbortSignal): void {
  const down = new Set<string>();
  const drive = () => {
    desk.orbit.drive(Object.assign({}, ...[...down].map((key) => DRIVES[key])));
    desk.wake();
  };
  const release = () => {
    down.clear();
    drive();
  };
  const press = (event: KeyboardEvent) => {
    const key = event.key.toLowerCase();
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    if (own(event.composedPath()[0], key)) return;
    const command = COMMANDS[(event.shiftKey && key.startsWith("arrow") ? "shift+" : "") + key];
    if (!command && !DRIVES[key]) return;
    event.preventDefault();
    if (command) {
      if (!event.repeat || key === "," || key === ".") command(desk);
    } else if (!event.repeat) {
      down.add(key);
      drive();
    }
  };
  area.addEventListener("keydown", press, { signal });
  area.addEventListener("keyup", (event) => down.delete(event.key.toLowerCase()) && drive(), { signal });
  area.addEventListener("focusout", release, { signal });
  window.addEventListener("blur", release, { signal });
}
