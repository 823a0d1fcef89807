// What tests do with the element, each with input as people give it, and what they report.
import { FormatError } from "../../src/format/errors.ts";
import { PlayerElement } from "../../src/ui/element.ts";
import { lacking } from "../../src/ui/trouble.ts";
import { FakePlayer, type Pretence } from "./fake-player.ts";

declare global {
  interface Window {
    drive(method: string, ...values: unknown[]): Promise<unknown>;
  }
}

let pretence: Partial<Pretence> = {};
/** In the order in which they were made. */
const players: FakePlayer[] = [];
let lacks = () => false;

export class FakeElement extends PlayerElement {
  override create(canvas: HTMLCanvasElement, settings: { policy?: string; loop?: boolean }): FakePlayer {
    const made = new FakePlayer(canvas, settings, pretence);
    players.push(made);
    return made;
  }

  override lacks(): boolean {
    return lacks();
  }
}

customElements.define("fake-player", FakeElement);

type Attributes = Readonly<Record<string, string>>;

const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
const pictures = async (count = 2) => {
  for (let i = 0; i < count; i++) await new Promise((resolve) => requestAnimationFrame(resolve));
};

/** An element of 640 × 360 pixels at (0, 0), with controls; `open`: wait until there is a picture. */
async function element(
  attributes: Attributes = {},
  pretend: Partial<Pretence> = {},
  open = true,
): Promise<FakeElement> {
  pretence = pretend;
  const node = document.createElement("fake-player") as FakeElement;
  const all = { src: "scene.airgs/", controls: "", style: "inline-size: 640px", ...attributes };
  for (const [name, value] of Object.entries(all)) node.setAttribute(name, value);
  document.body.style.margin = "0";
  const first = new Promise((resolve) => node.addEventListener("firstpicture", resolve, { once: true }));
  document.body.append(node);
  if (open) await first;
  if (open && node.controls) await until(() => !!find(node, ".panel")); // it is loaded later than the rest
  await pictures();
  return node;
}

/** Nothing of a case that was; timers, touches and the address stay as it left them. */
export function clear(): void {
  document.body.replaceChildren();
  document.body.removeAttribute("style");
  scrollTo(0, 0);
  players.length = 0;
}

const player = (node: FakeElement) => node.player as FakePlayer;
const inside = (node: FakeElement) => node.shadowRoot as ShadowRoot;
const find = (node: FakeElement, selector: string) => inside(node).querySelector<HTMLElement>(selector)!;
const button = (node: FakeElement, label: string) => find(node, `button[aria-label^="${label}"]`);
const away = (node: FakeElement) => Math.hypot(...player(node).camera.position);

async function press(...keys: string[]): Promise<void> {
  for (const key of keys) await window.drive("keyboard.press", key);
}

async function drag(from: readonly [number, number], to: readonly [number, number], which = "left"): Promise<void> {
  await window.drive("mouse.move", ...from);
  await window.drive("mouse.down", { button: which });
  await window.drive("mouse.move", ...to, { steps: 5 });
  await wait(150); // no fling
  await window.drive("mouse.up", { button: which });
}

async function click(node: HTMLElement): Promise<void> {
  const { left, top, width, height } = node.getBoundingClientRect();
  await window.drive("mouse.move", left + width / 2, top + height / 2);
  await window.drive("mouse.down");
  await window.drive("mouse.up");
  await pictures();
}

/** Whether something comes about, sooner or later. */
async function until(condition: () => boolean): Promise<boolean> {
  for (let i = 0; i < 100 && !condition(); i++) await wait(200);
  return condition();
}

/** The same within some pictures, such as those of a transition, whatever timers do. */
async function soon(condition: () => boolean): Promise<boolean> {
  for (let i = 0; i < 600 && !condition(); i++) await pictures(1);
  return condition();
}

/** From now on timers of the page wait for the function that is returned, which lets milliseconds pass. */
function holdTimers(): (ms: number) => void {
  const waiting = new Map<number, { atMs: number; run: () => void }>();
  let [nowMs, last] = [0, 1e9];
  const hold = (run: () => void, ms = 0) => {
    waiting.set(++last, { atMs: nowMs + ms, run });
    return last;
  };
  const { clearTimeout } = window;
  Object.assign(window, {
    setTimeout: hold,
    clearTimeout: (id?: number) => waiting.delete(id ?? 0) || clearTimeout(id),
  });
  return (ms) => {
    nowMs += ms;
    for (const [id, { atMs, run }] of [...waiting].sort(([, a], [, b]) => a.atMs - b.atMs)) {
      if (atMs <= nowMs && waiting.delete(id)) run();
    }
  };
}

/** Until nothing moves by itself. */
async function rest(node: FakeElement): Promise<void> {
  let before = "";
  while (before !== JSON.stringify(player(node).camera)) {
    before = JSON.stringify(player(node).camera);
    await pictures(10);
  }
}

const shown = (node: HTMLElement) => getComputedStyle(node).visibility !== "hidden" && node.getClientRects().length > 0;

export const cases: Record<string, () => Promise<object>> = {
  /** The element stays there, for pictures. */
  async look() {
    const query = new URLSearchParams(location.search);
    const { error, lack, ...rest } = JSON.parse(query.get("pretend") ?? "{}");
    if (error === "format") rest.refusal = new FormatError("hash_mismatch", "group/3.json.gz", "expected … got …");
    if (error === "network") rest.refusal = Object.assign(new Error("no answer"), { name: "TransportError" });
    if (error === "luma") rest.refusal = Object.assign(new Error("changes luma"), { name: "UnsupportedError" });
    if (lack === "secure") {
      Object.defineProperty(window, "isSecureContext", { value: false });
      lacks = () => lacking() !== null;
    }
    if (lack === "codecs") {
      Reflect.deleteProperty(globalThis, "VideoDecoder");
      lacks = () => lacking() !== null;
    }
    const attributes = JSON.parse(query.get("attributes") ?? "{}");
    await element({ style: "position: fixed; inset: 0; block-size: 100dvh", ...attributes }, rest, false);
    await wait(200);
    return {};
  },

  async drag() {
    const node = await element();
    const first = player(node).camera;
    await drag([320, 150], [345, 150]);
    await rest(node);
    const turned = player(node).camera;
    await window.drive("keyboard.down", "Shift");
    await drag([320, 150], [320, 175]);
    await window.drive("keyboard.up", "Shift");
    await rest(node);
    const moved = player(node).camera;
    await window.drive("mouse.dblclick", 320, 150);
    await rest(node);
    return { first, turned, moved, last: player(node).camera, paused: player(node).paused };
  },

  async path() {
    const keyframe = (t: number, x: number) => ({ t, position: [x, -0.6, -4], focus: [0, 0, 0], fov_y: 30 });
    const json = JSON.stringify({ keyframes: [keyframe(0, 0.2), keyframe(60, 1)] });
    const node = await element({ path: `data:application/json,${encodeURIComponent(json)}` });
    const first = player(node).camera;
    node.play();
    await soon(() => player(node).camera.position[0] > first.position[0]);
    const gone = player(node).camera;
    await drag([320, 150], [330, 150]);
    await rest(node);
    const { paused } = node;
    const wrong = await element({ path: "data:application/json,[]" });
    return { first, gone, paused, camera: player(wrong).camera, note: find(wrong, ".notes").textContent };
  },

  async split() {
    const node = await element({ split: "Q1+L1", loop: "" });
    await until(() => !find(node, ".seam").hidden);
    const [, second] = players;
    node.seek(30);
    await pictures();
    await drag([200, 150], [225, 150]);
    await rest(node);
    const still = { time: second.currentTime, camera: second.camera, quality: second.quality, paused: second.paused };
    node.play();
    second.seek(29.5);
    await soon(() => node.currentTime > 30.2 && second.currentTime > node.currentTime - 0.2);
    const plays = { paused: second.paused, apart: node.currentTime - second.currentTime };
    node.pause();
    const first = { camera: player(node).camera, calls: second.calls };
    const clip = () => find(node, ".second").style.clipPath;
    await drag([320, 100], [160, 100]);
    const dragged = { clip: clip(), camera: player(node).camera };
    await press("ArrowRight");
    const labels = find(node, ".seam").innerText;
    const keyed = { clip: clip(), now: find(node, ".seam").ariaValueNow, labels };
    node.remove();
    await pictures();
    const wrong = await element({ split: "Q9+L9" });
    await until(() => find(wrong, ".notes").textContent !== "");
    const note = find(wrong, ".notes").textContent;
    return { still, first, plays, dragged, keyed, closed: second.closed, note, made: players.length };
  },

  async parts() {
    const node = await element({}, {}, false);
    await until(() => !!find(node, ".note"));
    await click(button(node, "Quality"));
    await press("i");
    node.play();
    await soon(() => node.currentTime > 0);
    return { note: find(node, ".notes").textContent, menu: !!find(node, ".menu"), time: node.currentTime };
  },

  async wall() {
    const node = await element();
    await window.drive("mouse.move", 320, 150);
    await window.drive("mouse.down");
    for (let i = 1; i <= 10; i++) await window.drive("mouse.move", 320 + 30 * i, 150);
    await pictures();
    const pulled = player(node).camera;
    await wait(150);
    await window.drive("mouse.up");
    await rest(node);
    const back = player(node).camera;
    await click(button(node, "Leave the viewing region"));
    await drag([20, 150], [600, 150]);
    await rest(node);
    return {
      pulled,
      back,
      free: player(node).camera,
      note: find(node, ".notes").textContent,
      attribute: node.viewRegion,
    };
  },

  async wheel() {
    const node = await element();
    const first = away(node);
    document.body.style.blockSize = "2000px";
    const turn = async (down: number) => {
      await window.drive("mouse.wheel", 0, down);
      await wait(150);
      await rest(node);
      return [away(node), scrollY];
    };
    await window.drive("mouse.move", 320, 150);
    const passing = await turn(20);
    scrollTo(0, 0);
    node.toggleAttribute("capture");
    const captured = await turn(-120);
    node.toggleAttribute("capture");
    await window.drive("mouse.click", 320, 150);
    return { first, passing, captured, clicked: await turn(120) };
  },

  async touch() {
    const touch = (type: string, ...points: (readonly [number, number])[]) => {
      const touchPoints = points.map(([x, y], id) => ({ x, y, id }));
      return window.drive("cdp.Input.dispatchTouchEvent", { type: `touch${type}`, touchPoints });
    };
    await window.drive("cdp.Emulation.setTouchEmulationEnabled", { enabled: true, maxTouchPoints: 2 });
    const node = await element({ autoplay: "" });
    await touch("Start", [300, 100]);
    for (let i = 1; i <= 5; i++) await touch("Move", [300 + 6 * i, 100]);
    await wait(150);
    await touch("End");
    await rest(node);
    const turned = player(node).camera;
    await touch("Start", [300, 100], [340, 100]);
    for (let i = 1; i <= 5; i++) await touch("Move", [300 - 3 * i, 100], [340 + 3 * i, 100]);
    await wait(150);
    await touch("End");
    await rest(node);
    const pinched = player(node).camera;
    document.body.style.blockSize = "4000px";
    await touch("Start", [300, 300]);
    for (let i = 1; i <= 15; i++) await touch("Move", [300, 300 - 10 * i]);
    await touch("End");
    await until(() => scrollY > 50);
    const scrolled = { by: scrollY, camera: player(node).camera };
    scrollTo(0, 0);
    const there: boolean[] = [];
    for (let i = 0; i < 2; i++) {
      await touch("Start", [300, 100]);
      await touch("End");
      await pictures();
      there.push(find(node, ".frame").classList.contains("idle"));
    }
    return { turned, pinched, scrolled, there };
  },

  async keys() {
    const node = await element();
    node.focus();
    const seen: Record<string, unknown> = {
      focused: inside(node).activeElement?.className,
      first: player(node).camera,
    };
    for (const key of ["ArrowRight", "ArrowUp", "+", "d", "r"]) {
      await press(key);
      await rest(node);
      seen[key] = player(node).camera;
    }
    await press(" ");
    seen.plays = !player(node).paused;
    await press(" ", "l", "l", "j", ".", ",", "Shift+ArrowRight", "i");
    await pictures();
    seen.calls = player(node).calls;
    seen.panel = shown(find(node, ".panel"));
    await press("5");
    seen.after = player(node).calls.length;
    await press("?");
    seen.card = find(node, "[role=dialog]").innerText;
    await press("?");
    seen.left = find(node, "[role=dialog]") === null;
    return seen;
  },

  async sound() {
    const silent = await element();
    const offered = [!find(silent, "[data-icon=sound], [data-icon=mute]").hidden];
    await press("m");
    silent.remove();
    const node = await element({ muted: "" }, { hasSound: true });
    const seen = [[player(node).muted, node.muted]];
    offered.push(shown(button(node, "Sound on")));
    await click(button(node, "Sound on"));
    seen.push([player(node).muted, node.muted]);
    node.focus();
    await press("m");
    await pictures();
    seen.push([player(node).muted, node.muted]);
    node.muted = false;
    node.volume = 0.5;
    return { offered, seen: [...seen, [player(node).muted, node.muted]], volume: player(node).volume };
  },

  async scrub() {
    const node = await element();
    const { left, width, top, height } = find(node, ".timeline").getBoundingClientRect();
    const y = top + height / 2;
    await drag([left + 2, y], [left + width / 2, y]);
    const dragged = player(node).currentTime;
    const { ariaValueNow, ariaValueMax, ariaValueText } = find(node, ".timeline");
    find(node, ".timeline").focus();
    await press("ArrowRight");
    const stepped = player(node).currentTime;
    await press("End");
    const end = player(node).currentTime;
    await press("Home");
    const home = player(node).currentTime;
    return { dragged, stepped, end, home, aria: { ariaValueNow, ariaValueMax, ariaValueText } };
  },

  async menu() {
    const node = await element({ style: "inline-size: 960px" });
    await click(button(node, "Quality"));
    const items = [...inside(node).querySelectorAll("[role^=menuitem]")].map((item) => [item.role, item.textContent]);
    const best = [...inside(node).querySelectorAll<HTMLElement>("[role=menuitemradio]")][1];
    await click(best);
    const picked = player(node).quality;
    const closed = !shown(find(node, ".menu"));
    const focused = inside(node).activeElement?.ariaLabel;
    await press("Enter", "ArrowDown", "Enter");
    const second = player(node).quality;
    await click(button(node, "Speed"));
    await press("End", "Enter");
    await press("Enter", "Escape");
    return { items, picked, closed, focused, second, speed: player(node).speed, attribute: node.quality };
  },

  async hide() {
    const node = await element({ autoplay: "" });
    const pass = holdTimers();
    await window.drive("mouse.move", 320, 150);
    pass(2700);
    const there = shown(find(node, ".bar"));
    pass(100);
    const gone = await soon(() => !shown(find(node, ".bar")));
    await window.drive("mouse.move", 330, 150);
    const back = await soon(() => shown(find(node, ".bar")));
    node.pause();
    pass(3600);
    return { there, gone, back, paused: !find(node, ".frame").classList.contains("idle") };
  },

  async life() {
    let [listeners, loops] = [0, 0];
    const [add, request] = [EventTarget.prototype.addEventListener, window.requestAnimationFrame];
    const shared: EventTarget[] = [window, document, document.documentElement];
    EventTarget.prototype.addEventListener = function (name, heard, options) {
      const signal = typeof options === "object" ? options.signal : undefined;
      if (shared.includes(this)) {
        listeners++;
        signal?.addEventListener("abort", () => listeners--);
      }
      add.call(this, name, heard, options);
    };
    const node = await element({ autoplay: "", loop: "" });
    const first = player(node);
    const during = listeners;
    let told = 0;
    node.addEventListener("time", () => told++);
    await until(() => told > 0);
    node.remove();
    const after = told;
    window.requestAnimationFrame = (run) => {
      loops++;
      return request(run);
    };
    first.dispatchEvent(new CustomEvent("time"));
    await wait(200);
    window.requestAnimationFrame = request;
    EventTarget.prototype.addEventListener = add;
    const gone = { closed: first.closed, listeners, loops, told: told - after, empty: inside(node).childNodes.length };
    document.body.append(node);
    await until(() => told > after);
    const again = { other: player(node) !== first, open: player(node).duration > 0, told: told > after };
    node.setAttribute("src", "other.airgs/");
    return { during, told: after, gone, again, replaced: player(node) !== first && player(node).calls[0] };
  },

  async names() {
    const node = await element({ style: "inline-size: 960px" }, { live: true });
    const controls = [...inside(node).querySelectorAll<HTMLElement>(".bar button, [role=slider], [role=application]")];
    const named = controls.filter(shown).map((one) => [one.role ?? one.localName, one.ariaLabel]);
    const order: (string | null | undefined)[] = [];
    node.focus();
    for (let i = 0; i < 16; i++) {
      order.push(inside(node).activeElement?.ariaLabel);
      await press("Tab");
    }
    const up = player(node).camera.up[1];
    await click(button(node, "Turn over"));
    await click(button(node, "Compare"));
    await until(() => !!find(node, ".seam:not([hidden])"));
    const second = players[1].quality;
    await click(button(node, "Compare"));
    const { camera } = player(node);
    return {
      named,
      order,
      live: find(node, ".notes").ariaLive,
      ups: [up, camera.up[1]],
      second,
      split: find(node, ".seam"),
    };
  },

  async trouble() {
    const said: Record<string, unknown> = {};
    const say = async (name: string, pretend: Partial<Pretence>) => {
      const node = await element({}, pretend, false);
      await until(() => find(node, ".card") !== null);
      const card = find(node, ".card");
      said[name] = { role: card.role, text: card.textContent, controls: shown(find(node, ".bar")) };
      node.remove();
    };
    await say("refused", { refusal: new FormatError("hash_mismatch", "group/3.json.gz", "expected a, got b") });
    await say("newer", { refusal: new FormatError("unknown_version", "airgs.json", "expected 12, got 99") });
    await say("network", { refusal: Object.assign(new Error("no answer"), { name: "TransportError" }) });
    const node = await element();
    player(node).problem({ message: "delta/L0/3.m4s: no answer, trying again", fatal: false, error: null });
    said.note = find(node, ".notes").textContent;
    player(node).dispatchEvent(new CustomEvent("progress"));
    await until(() => find(node, ".notes").textContent === "");
    said.cleared = find(node, ".notes").textContent;
    player(node).problem({ message: "gone for good", fatal: true, error: null });
    await until(() => find(node, ".card") !== null);
    said.fatal = find(node, ".card").textContent;
    return said;
  },

  async address() {
    let copied = "";
    Object.defineProperty(navigator, "clipboard", {
      configurable: true,
      value: { writeText: async (text: string) => (copied = text) },
    });
    const told = "#t=42.5&view=0.3,-0.5,-3.9,0.1,0,0,0,1,0&rung=Q1+L2&speed=0.5";
    location.hash = `${told}&speed=-1`;
    const node = await element({ hash: "", style: "inline-size: 960px" });
    const note = find(node, ".notes").textContent;
    const opened = { ...player(node).camera, rung: player(node).quality, speed: player(node).speed, at: node.at };
    const calls = player(node).calls.slice(1);
    const before = location.href;
    await click(button(node, "Copy a link"));
    await until(() => copied !== "");
    const said = find(node, ".notes").textContent;
    node.focus();
    await press("ArrowRight", "o");
    await rest(node);
    const moved = player(node).camera;
    await press("b", "ArrowRight");
    await rest(node);
    await press("r");
    await rest(node);
    const again = player(node).camera;
    const silent = location.href === before;
    location.hash = "view=9,0,0,0,0,0";
    await until(() => node.viewRegion === "free");
    await rest(node);
    const out = player(node).camera;
    await press("Home");
    await rest(node);
    const home = player(node).camera;
    Object.defineProperty(navigator, "clipboard", { value: undefined });
    await press("c");
    await until(() => location.hash.startsWith("#t="));
    const shown = decodeURIComponent(location.hash);
    const other = await element();
    const plain = { camera: player(other).camera, offered: find(other, "[aria-label^='Copy']").hidden };
    return { note, opened, calls, copied, said, moved, again, silent, out, home, shown, plain };
  },

  async live() {
    const node = await element({ autoplay: "" }, { live: true });
    const badge = button(node, "Live");
    const behind = badge.ariaLabel;
    await click(badge);
    await until(() => badge.ariaLabel !== behind);
    return { behind, time: player(node).currentTime, duration: player(node).duration, newest: badge.ariaLabel };
  },
};
