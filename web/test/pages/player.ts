// What the player does on a page, one check a visit. Query: src, check, and what the check takes.
import type { Player } from "../../src/airgs.ts";
import { cameraOf } from "../../src/format/region.ts";
import { canvas, gl, number, query, shown, sleep, start, until } from "../support/player-page.ts";

let draws = 0; // into the canvas, since somebody looked
const { drawArrays } = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.drawArrays = function (...args) {
  if (this.getParameter(this.FRAMEBUFFER_BINDING) === null) draws++;
  drawArrays.apply(this, args);
};

/** r, g, b, 255 of what is drawn for the next frame of the display, the top line first; null: nothing is. */
async function drawn(): Promise<Uint8Array | null> {
  draws = 0;
  await shown();
  if (!draws) return null;
  const context = gl();
  const [width, height] = [canvas.width, canvas.height];
  const raw = new Uint8Array(4 * width * height);
  context.bindFramebuffer(context.FRAMEBUFFER, null);
  context.readPixels(0, 0, width, height, context.RGBA, context.UNSIGNED_BYTE, raw);
  const line = 4 * width;
  const out = new Uint8Array(raw.length);
  for (let at = 0; at < raw.length; at += line) out.set(raw.subarray(at, at + line), raw.length - line - at);
  return out;
}

/** The picture that is drawn next. */
async function picture(player: Player): Promise<Uint8Array> {
  for (let look = 0; look < 200; look++) {
    player.camera = { ...player.camera }; // something to draw
    const found = await drawn();
    if (found) return found;
  }
  throw new Error("nothing is drawn");
}

/** The picture that does not change any more: the order in depth comes later than the frame. */
async function settled(player: Player): Promise<Uint8Array> {
  for (let before = await picture(player); ; ) {
    await sleep(300);
    const now = await picture(player);
    if (now.every((value, i) => value === before[i])) return now;
    before = now;
  }
}

const base64 = (bytes: Uint8Array) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));

/** Mean of r, g, b. */
function brightness(pixels: Uint8Array): number {
  let sum = 0;
  for (let i = 0; i < pixels.length; i++) if (i % 4 !== 3) sum += pixels[i];
  return sum / (0.75 * pixels.length);
}

/** The camera of the pictures, as JSON. */
function seenBy(player: Player) {
  const { worldToCamera, ...lens } = cameraOf(player.camera, canvas.width, canvas.height);
  return { ...lens, worldToCamera: Array.from(worldToCamera) };
}

const checks: Record<string, () => Promise<unknown>> = {
  /** Plays once, to the end. */
  async once() {
    const log = await start({ loop: false });
    await until("the end", () => log.player.ended);
    return log.report();
  },

  /** Plays over and over until so many frames were shown; the brightness of the darkest picture and of the brightest. */
  async loop() {
    const log = await start();
    await until("a picture", () => log.has("firstpicture"));
    const seen: number[] = [];
    while (log.player.stats.framesShown <= number("frames", 24)) {
      const pixels = await drawn();
      if (pixels) seen.push(brightness(pixels));
    }
    return { ...log.report(), pictures: seen.length, darkest: Math.min(...seen), brightest: Math.max(...seen) };
  },

  /** Goes to frames while it is paused, in any order, in one rung; the picture of each. */
  async seek() {
    const log = await start({ loop: false });
    const { player } = log;
    const rung = query.get("rung") ?? "";
    player.quality = rung;
    player.pause();
    await until("a picture", () => log.has("firstpicture"));
    const pictures = [];
    for (const frame of JSON.parse(query.get("frames") ?? "[]") as number[]) {
      await player.seek(frame / number("fps", 24));
      await until(`frame ${frame}`, () => !player.seeking && player.rungs[player.rung ?? 0].name === rung);
      pictures.push({ frame, picture: base64(await settled(player)) });
    }
    return { ...log.report(), pictures, camera: seenBy(player) };
  },

  /** Loses the WebGL context, gets it back, and goes on. */
  async lost() {
    const log = await start();
    await until("a picture", () => log.has("firstpicture"));
    const extension = gl().getExtension("WEBGL_lose_context");
    extension?.loseContext();
    await until("the loss", () => log.has("lost"));
    await sleep(300);
    extension?.restoreContext();
    await until("the return", () => log.has("restored"));
    const before = log.player.stats.framesShown;
    await until("more frames", () => log.player.stats.framesShown > before + 5);
    return { ...log.report(), brightness: brightness(await picture(log.player)) };
  },

  /** Hides the page for a while, in which browsers draw nothing; it goes on where it was. */
  async hidden() {
    const log = await start();
    await until("a picture", () => log.has("firstpicture"));
    let hidden = true;
    Object.defineProperty(document, "hidden", { get: () => hidden });
    document.dispatchEvent(new Event("visibilitychange"));
    await sleep(500); // a frame that was due before is decoded and shown
    await shown();
    const before = log.player.currentTime;
    const request = window.requestAnimationFrame;
    const asked: FrameRequestCallback[] = [];
    window.requestAnimationFrame = (callback) => asked.push(callback);
    await sleep(1500);
    const after = log.player.currentTime;
    hidden = false;
    document.dispatchEvent(new Event("visibilitychange"));
    window.requestAnimationFrame = request;
    for (const callback of asked) request(callback);
    const { framesShown } = log.player.stats;
    await until("more frames", () => log.player.stats.framesShown > framesShown + 5);
    return { ...log.report(), before, after };
  },

  /** Plays at double speed, with one rung after the other from the menu. */
  async menu() {
    const log = await start();
    const { player } = log;
    await until("a picture", () => log.has("firstpicture"));
    player.speed = 2;
    for (const name of JSON.parse(query.get("names") ?? "[]") as string[]) {
      player.quality = name;
      await until(`rung ${name}`, () => log.rungs.at(-1) === name);
    }
    return log.report();
  },

  /** Plays for some seconds, or until so many frames were shown, whatever happens. */
  async play() {
    const log = await start({ loop: query.get("loop") !== "0" });
    const end = performance.now() + 1e3 * number("seconds", 10);
    const frames = number("frames", Number.POSITIVE_INFINITY);
    while (performance.now() < end && log.player.stats.framesShown < frames && !log.player.ended) await sleep(50);
    return log.report();
  },
};

Object.assign(window, { report: checks[query.get("check") ?? "play"]() });
