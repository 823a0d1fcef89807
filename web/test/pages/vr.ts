// The page that is shipped in a browser with a headset that only pretends (iwer), or without one (query: without).
import { metaQuest3, XRDevice } from "iwer";
import type { Player } from "../../src/airgs.ts";
import type { AirgsPlayer } from "../../src/airgs-player.ts";

declare global {
  interface Window {
    drive(method: string, ...values: unknown[]): Promise<unknown>;
    report: Promise<object>;
  }
}

const WINDOW = { width: 320, height: 160 }; // the picture of an eye is a half of it
const FRAMES = 20;
/** How much further than to the other the lens of an eye shows to its own side, and up than down. */
const [OUT, UP] = [0.2, 0.1];
const MOVED = { position: [0.1, 0.05, -0.2], turn: 0.3 } as const; // metres, radians to the left

const device = new XRDevice(metaQuest3, { stereoEnabled: true });
const wait = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
const node = () => document.querySelector<AirgsPlayer>("airgs-player");
const player = () => node()?.player as unknown as Player;
const button = () => node()?.shadowRoot?.querySelector<HTMLButtonElement>("[data-icon=vr]") ?? null;
const isShown = () => !!button()?.checkVisibility();

let session: XRSession | null = null;
/** By scene: that of the next group is sorted as well. */
const sorts = new Map<string, number>();
let sorting = false; // an order in depth was asked for and has not come
let draws = 0; // into the canvas

/** Counts what is drawn and sorted, knows the session, and grinds the lenses. */
function watch(): void {
  const { requestSession } = navigator.xr as XRSystem;
  (navigator.xr as XRSystem).requestSession = async function (...asked) {
    session = await requestSession.apply(this, asked);
    return session;
  };
  const { drawArrays } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.drawArrays = function (...values) {
    if (this.getParameter(this.FRAMEBUFFER_BINDING) === null) draws++;
    drawArrays.apply(this, values);
  };
  const { postMessage } = Worker.prototype;
  Worker.prototype.postMessage = function (...values: unknown[]) {
    const { view, key = "" } = values[0] as { view?: unknown; key?: string };
    if (view) {
      sorts.set(key, 1 + (sorts.get(key) ?? 0));
      sorting = true;
      this.addEventListener("message", () => (sorting = false), { once: true });
    }
    Reflect.apply(postMessage, this, values);
  };
  const usual = Object.getOwnPropertyDescriptor(XRView.prototype, "projectionMatrix")?.get as () => Float32Array;
  Object.defineProperty(XRView.prototype, "projectionMatrix", {
    get(this: XRView) {
      const lens = Float32Array.from(usual.call(this));
      lens[8] = this.eye === "left" ? -OUT : OUT;
      lens[9] = UP;
      return lens;
    },
  });
}

async function until(what: string, condition: () => boolean, seconds = 30): Promise<void> {
  const end = performance.now() + 1e3 * seconds;
  while (!condition()) {
    if (performance.now() > end) throw new Error(`${what}: not within ${seconds} s`);
    await wait(20);
  }
}

async function click(): Promise<void> {
  const { left, top, width, height } = (button() as HTMLElement).getBoundingClientRect();
  await window.drive("mouse.click", left + width / 2, top + height / 2);
}

/** r, g, b, 255 of what a frame of the headset, or of the page, shows, the top line first. */
async function pixels(): Promise<Uint8Array> {
  await new Promise((resolve) => (session ?? window).requestAnimationFrame(resolve));
  const gl = player().canvas.getContext("webgl2") as WebGL2RenderingContext;
  const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
  const raw = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, raw);
  const [line, out] = [4 * width, new Uint8Array(raw.length)];
  for (let at = 0; at < raw.length; at += line) out.set(raw.subarray(at, at + line), raw.length - line - at);
  return out;
}

/** Both eyes beside each other, when they do not change any more: the order in depth comes later than the view. */
async function eyes(): Promise<string> {
  for (let before = await pixels(), same = 0; ; ) {
    for (let frame = 0; frame < FRAMES || sorting; frame++) await pixels();
    const now = await pixels();
    same = now.every((value, i) => value === before[i]) ? same + 1 : 0;
    if (same === 3) return btoa(Array.from(now, (byte) => String.fromCharCode(byte)).join(""));
    before = now;
  }
}

async function counts() {
  await pixels();
  sorts.clear();
  draws = 0;
  for (let frame = 0; frame < FRAMES; frame++) await pixels();
  return { frames: FRAMES, sorts: Math.max(...sorts.values()), draws };
}

async function pull(): Promise<void> {
  for (const value of [1, 0]) {
    device.controllers.right?.updateButtonValue("trigger", value);
    await pixels();
    await pixels();
  }
}

async function plays(): Promise<boolean> {
  const { framesShown } = player().stats;
  await until("more frames", () => player().stats.framesShown > framesShown + 3);
  return !player().paused;
}

async function wear() {
  player().pause();
  player().quality = "Q0+L0";
  await player().seek(0);
  await until("the first frame", () => !player().seeking && player().rungs[player().rung ?? 0].name === "Q0+L0");
  const before = player().camera.position;
  await until("the button", isShown);
  await click();
  await until("the headset", () => player().vr && !!session);
  const first = await eyes();
  const counted = await counts();
  const [x, y, z] = MOVED.position;
  device.position.set(device.position.x + x, device.position.y + y, device.position.z + z);
  device.quaternion.set(0, Math.sin(MOVED.turn / 2), 0, Math.cos(MOVED.turn / 2));
  const moved = await eyes();
  await pull();
  const played = await plays();
  player().leaveVr();
  session = null;
  await until("the page", () => !player().vr && button()?.ariaLabel === "Enter VR");
  const goesOn = await plays();
  let page = false;
  while (!page) page = (await pixels()).some((value, i) => i % 4 < 3 && value > 30);
  return {
    first,
    moved,
    counted,
    played,
    ipd: device.ipd,
    before,
    after: player().camera.position,
    goesOn,
    page,
  };
}

async function run(): Promise<object> {
  await window.drive("setViewportSize", WINDOW);
  await until("a picture", () => player()?.stats.framesShown > 0, 60);
  if (!new URLSearchParams(location.search).has("without")) return await wear();
  await wait(500);
  return { there: !!button(), shown: isShown() };
}

if (!new URLSearchParams(location.search).has("without")) {
  device.installRuntime({ forceInstall: true });
  watch();
}
window.report = run();
