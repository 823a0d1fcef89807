// Pictures of the renderer against those of the CPU renderer: /plan.json lists checks, `window.report` is what came of each.
import type { Camera } from "../../src/format/types.ts";
import { Renderer, type RendererOptions, type Scene } from "../../src/render/renderer.ts";
import { Sorter } from "../../src/render/sorter.ts";
import { readBytes, readFloat } from "../support/read-pixels.ts";
import { Decoded, type Frame, type Rung } from "./decoded.ts";

interface Step {
  name: string;
  check: string;
  data: string;
  target: "rgba16f" | "rgb10_a2";
  /** One of so many frames is shown, the others are dropped. */
  every: number;
}

const canvas = document.createElement("canvas");
document.body.append(canvas);

interface Picture {
  rung: number;
  frame: number;
  camera: number;
  /** PSNR in dB of 8 bits and of floats, both clipped to 0 … 1. */
  bytes: number;
  floats: number;
}

const decibels = (squares: number, count: number) => (squares ? -10 * Math.log10(squares / count) : 200);
const clipped = (value: number) => Math.min(1, Math.max(0, value));

/** What is on the canvas against r, g, b of `truth`; the background is black. */
function compare(renderer: Renderer, truth: Float32Array): { bytes: number; floats: number } {
  const [bytes, floats] = [readBytes(renderer, canvas), readFloat(renderer, canvas)];
  let [inBytes, inFloats] = [0, 0];
  for (let i = 0; i < truth.length; i++) {
    const at = 4 * Math.floor(i / 3) + (i % 3);
    const wanted = clipped(truth[i]);
    inBytes += ((bytes[at] - Math.round(255 * wanted)) / 255) ** 2;
    inFloats += (clipped(floats[at]) - wanted) ** 2;
  }
  return { bytes: decibels(inBytes, truth.length), floats: decibels(inFloats, truth.length) };
}

/** One of a rung's scenes, with all that the checks do to it. */
class Stage {
  readonly renderer: Renderer;
  readonly sorter = new Sorter();
  readonly errors: string[] = [];
  readonly #gl: WebGL2RenderingContext;

  constructor(options: RendererOptions = {}) {
    this.renderer = new Renderer(canvas, options);
    this.#gl = canvas.getContext("webgl2")!;
  }

  /** Notes the error of WebGL, if there is one. */
  look(step: string): void {
    const error = this.#gl.getError();
    if (error) this.errors.push(`${step}: ${error}`);
  }

  async order(scene: Scene, means: Float32Array, camera: Camera): Promise<void> {
    const rows = await this.sorter.order(means, "scene", camera);
    scene.sort(rows!);
    this.look("order");
    while (!this.renderer.ready(scene)) await new Promise((resolve) => setTimeout(resolve, 5));
    this.look("ready");
  }

  draw(scene: Scene, camera: Camera): void {
    [canvas.width, canvas.height] = [camera.width, camera.height];
    if (!this.renderer.draw(scene, camera)) this.errors.push("draw: nothing was drawn");
    this.look("draw");
  }

  /** Goes to a frame; shown or dropped, its bases are told. */
  step(scene: Scene, frame: Frame, shown: boolean, atlas: Parameters<Scene["delta"]>[0]): void {
    if (frame.changes) scene.change(frame.changes);
    if (shown) scene.delta(atlas, frame.luma, frame.time);
    this.look("state");
  }
}

/** Every frame of a rung that is not dropped, from every camera. */
async function play(stage: Stage, data: Decoded, rung: Rung, number: number, every: number): Promise<Picture[]> {
  const pictures: Picture[] = [];
  let count = 0;
  for (const { group, canonical, segments } of rung.groups) {
    const scene = stage.renderer.scene(data.root, group, canonical);
    stage.look("scene");
    for (const frames of segments) {
      scene.begin(rung.level);
      stage.look("level");
      for (const frame of frames) {
        const shown = ++count % every === 0;
        stage.step(scene, frame, shown, group.levels[rung.level]);
        for (const [n, camera] of shown ? data.cameras.entries() : []) {
          await stage.order(scene, frame.means, camera);
          stage.draw(scene, camera);
          pictures.push({ rung: number, frame: count - 1, camera: n, ...compare(stage.renderer, frame.pictures[n]) });
        }
      }
    }
    stage.renderer.free(scene);
    stage.look("free");
  }
  return pictures;
}

async function pictures(data: Decoded, { target, every }: Step) {
  const stage = new Stage({ target });
  const found: Picture[] = [];
  for (const [n, rung] of data.rungs.entries()) found.push(...(await play(stage, data, rung, n, every)));
  stage.renderer.dispose();
  return { target: stage.renderer.target, pictures: found, errors: stage.errors };
}

/** All rungs over one scene, switching in the middle of segments, as a session does that changes its mind. */
async function levels(data: Decoded) {
  const stage = new Stage();
  const [camera] = data.cameras;
  const found: Picture[] = [];
  const { group, canonical } = data.rungs[0].groups[0];
  const scene = stage.renderer.scene(data.root, group, canonical);
  for (const n of [0, 1, 0, 0, 1, 1]) {
    const { level, groups } = data.rungs[n];
    scene.begin(level);
    for (const [t, frame] of groups[0].segments[0].entries()) {
      if (t === 0 && found.length) {
        const before = readFloat(stage.renderer, canvas);
        scene.projectedFor = null;
        stage.draw(scene, camera); // a level alone changes nothing that is shown
        const after = readFloat(stage.renderer, canvas);
        if (before.some((value, i) => value !== after[i])) stage.errors.push("level: drawn at once");
      }
      stage.step(scene, frame, true, group.levels[level]);
      await stage.order(scene, frame.means, camera);
      stage.draw(scene, camera);
      found.push({ rung: n, frame: t, camera: 0, ...compare(stage.renderer, frame.pictures[0]) });
    }
  }
  return { pictures: found, errors: stage.errors };
}

/** The old group stays on the canvas until the new one has an order. */
async function change(data: Decoded) {
  const stage = new Stage();
  const [camera] = data.cameras;
  const [first, second] = data.rungs[0].groups;
  const frames = [first.segments[0][0], second.segments[0][0]];
  const { level } = data.rungs[0];
  const old = stage.renderer.scene(data.root, first.group, first.canonical);
  old.begin(level);
  stage.step(old, frames[0], true, first.group.levels[level]);
  await stage.order(old, frames[0].means, camera);
  stage.draw(old, camera);
  const before = readBytes(stage.renderer, canvas);
  const next = stage.renderer.scene(data.root, second.group, second.canonical);
  next.begin(level);
  stage.step(next, frames[1], true, second.group.levels[level]);
  const early = stage.renderer.ready(next) || stage.renderer.draw(next, camera);
  stage.draw(old, camera);
  const between = compare(stage.renderer, frames[0].pictures[0]);
  const same = readBytes(stage.renderer, canvas).every((value, i) => value === before[i]);
  await stage.order(next, frames[1].means, camera);
  stage.renderer.free(old);
  stage.draw(next, camera);
  const after = compare(stage.renderer, frames[1].pictures[0]);
  old.delta(first.group.levels[level], frames[0].luma);
  const freed = stage.renderer.draw(old, camera);
  stage.look("freed");
  return { early, same, between, after, freed, errors: stage.errors };
}

/** A lost context: nothing throws, and another renderer draws when it was restored. */
async function lost(data: Decoded) {
  const stage = new Stage();
  const [camera] = data.cameras;
  const { group, canonical, segments } = data.rungs[0].groups[0];
  const frame = segments[0][0];
  const { level } = data.rungs[0];
  const show = async (on: Stage) => {
    const scene = on.renderer.scene(data.root, group, canonical);
    scene.begin(level);
    on.step(scene, frame, true, group.levels[level]);
    await on.order(scene, frame.means, camera);
    on.draw(scene, camera);
    return scene;
  };
  const scene = await show(stage);
  const extension = canvas.getContext("webgl2")!.getExtension("WEBGL_lose_context")!;
  const heard = (name: string) => new Promise((resolve) => canvas.addEventListener(name, resolve, { once: true }));
  const gone = heard("webglcontextlost");
  extension.loseContext();
  await gone;
  const { renderer } = stage;
  const dead = renderer.scene(data.root, group, canonical);
  for (const one of [scene, dead]) {
    one.begin(level);
    one.change({ texels: Uint32Array.of(1), bases: Int32Array.of(1) });
    one.delta(group.levels[level], frame.luma);
    one.sort(Uint32Array.of(0));
  }
  const idle = [renderer.lost, renderer.busy, renderer.ready(dead), renderer.draw(scene, camera)];
  const sizes = [readBytes(renderer, canvas).length, readFloat(renderer, canvas).length];
  renderer.free(dead);
  const back = heard("webglcontextrestored");
  setTimeout(() => extension.restoreContext());
  await back;
  renderer.dispose();
  const again = new Stage();
  await show(again);
  return { idle, sizes, picture: compare(again.renderer, frame.pictures[0]), errors: again.errors };
}

/** Canvases of other sizes than the camera's, and a background. */
async function sizes(data: Decoded) {
  const stage = new Stage({ background: [0.25, 0.5, 1] });
  const [camera] = data.cameras;
  const { group, canonical, segments } = data.rungs[0].groups[0];
  const scene = stage.renderer.scene(data.root, group, canonical);
  await stage.order(scene, canonical.means, camera);
  const half = { ...camera, width: camera.width / 2, height: camera.height / 2 };
  const halves = { fx: camera.fx / 2, fy: camera.fy / 2, cx: camera.cx / 2, cy: camera.cy / 2 };
  stage.draw(scene, camera);
  const whole = readBytes(stage.renderer, canvas);
  stage.renderer.draw(scene, { ...half, ...halves }); // the canvas keeps its size
  stage.look("size");
  const scaled = readBytes(stage.renderer, canvas);
  [canvas.width, canvas.height] = [37, 91];
  const odd = stage.renderer.draw(scene, camera);
  stage.look("odd size");
  const corner = Array.from(readBytes(stage.renderer, canvas).subarray(0, 4));
  const length = readBytes(stage.renderer, canvas).length;
  stage.renderer.dispose();
  stage.renderer.dispose();
  const disposed = stage.renderer.draw(scene, camera);
  stage.look("disposed");
  const same = scaled.every((value, i) => value === whole[i]);
  return { same, odd, corner, length, disposed, segments: segments.length, errors: stage.errors };
}

/** What is refused, and that it is said clearly. */
async function refusals(data: Decoded) {
  const stage = new Stage();
  const { group, canonical, segments } = data.rungs[0].groups[0];
  const { level } = data.rungs[0];
  const atlas = group.levels[level];
  const luma = segments[0][0].luma!;
  const scene = stage.renderer.scene(data.root, group, canonical);
  const told = (act: () => void) => {
    try {
      act();
      return "";
    } catch (error) {
      return String(error);
    }
  };
  const messages = [told(() => scene.delta(atlas, luma))];
  scene.begin(level);
  messages.push(
    told(() => scene.delta(atlas, luma.subarray(1))),
    told(() => scene.delta({ ...atlas }, luma)),
    told(() => scene.sort(new Uint32Array(canonical.depths.length + 1))),
    told(() => new Renderer(Object.assign(document.createElement("canvas"), { getContext: () => null }))),
  );
  stage.look("refusals");
  return { messages, errors: stage.errors };
}

type Check = (data: Decoded, step: Step) => Promise<object>;
const CHECKS: Record<string, Check> = { pictures, levels, change, lost, sizes, refusals };

declare global {
  interface Window {
    report: Promise<object>;
  }
}

async function run(): Promise<Record<string, object>> {
  const plan: Step[] = await (await fetch("/plan.json")).json();
  const report: Record<string, object> = {};
  for (const step of plan) report[step.name] = await CHECKS[step.check](await Decoded.fetch(step.data), step);
  return report;
}

window.report = run();
