// What is on the canvas: a scene for each group on its way to the viewer, its rows' order in depth, and one picture drawn
// when something has changed.
import { cameraOf, type ViewState } from "../format/region.ts";
import type { Camera, Canonical, Group, Root } from "../format/types.ts";
import { UnsupportedError } from "../media/errors.ts";
import { type Drawn, Renderer, type Scene, type Surface } from "../render/renderer.ts";
import { Sorter } from "../render/sorter.ts";
import type { TargetFormat } from "../render/textures.ts";
import type { Clip } from "./pipeline.ts";

/** A canonical space on the GPU, and the clip of which it shows something. */
interface Stage {
  readonly key: string;
  readonly canonical: Canonical;
  readonly scene: Scene;
  clip: Clip | null;
  /** The frame up to which the bases of the clip were followed; -1: none. */
  frame: number;
  /** (3N) means that the sorter does not have yet; null: it has them. */
  means: Float32Array | null;
}

/** What an eye in a headset sees, and where it is drawn. */
interface Eye {
  camera: Camera;
  surface: Surface;
}

interface ScreenOptions {
  target: TargetFormat | undefined;
  /** The context is gone, or is back: what was shown must be shown again. */
  onLost: () => void;
  onRestored: () => void;
  onFail: (error: Error) => void;
}

/** Shows frames of clips on a canvas. While the WebGL context is lost, nothing is shown and nothing fails. */
export class Screen {
  #renderer: Renderer | null;
  readonly #sorter: Sorter;
  readonly #stages = new Map<Canonical, Stage>();
  #shown: Stage | null = null;
  #view: ViewState | null = null;
  #size = { width: 1, height: 1 };
  #dirty = false;
  #made = 0;
  readonly #end = new AbortController();

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly tables: { root: Root; group(number: number): Group },
    readonly options: ScreenOptions,
  ) {
    this.#renderer = this.#makeRenderer();
    const fail = (why: string) => options.onFail(new UnsupportedError(`the worker that sorts failed: ${why}`));
    this.#sorter = new Sorter(undefined, fail);
    const { signal } = this.#end;
    const lose = () => {
      this.#renderer = null;
      this.#stages.clear();
      this.#shown = null;
      options.onLost();
    };
    canvas.addEventListener("webglcontextlost", lose, { signal });
    const restore = () => {
      this.#renderer = this.#makeRenderer();
      options.onRestored();
    };
    canvas.addEventListener("webglcontextrestored", restore, { signal });
  }

  look(view: ViewState): void {
    this.#view = view;
    this.#dirty = true;
    for (const stage of this.#stages.values()) this.#sort(stage);
  }

  resize(width: number, height: number): boolean {
    const before = this.#size;
    this.#size = { width: Math.max(1, Math.round(width)), height: Math.max(1, Math.round(height)) };
    this.#dirty = true;
    return this.#size.width !== before.width || this.#size.height !== before.height;
  }

  /** Show a decoded frame from the next picture on. False: its scene has no order yet; the old picture stays. */
  show(clip: Clip, frame: number): boolean {
    const stage = this.prepare(clip);
    if (!stage || !this.#renderer?.ready(stage.scene)) return false;
    const { scene } = stage;
    if (stage.clip !== clip || frame < stage.frame) {
      scene.begin(clip.level);
      Object.assign(stage, { clip, frame: -1 });
    }
    for (let t = stage.frame + 1; t <= frame; t++) {
      const bases = clip.frames[t]?.bases;
      if (bases) scene.change(bases);
    }
    const state = clip.frames[frame];
    scene.delta(clip.atlas, state?.luma ?? null, state?.time);
    stage.means = state?.means ?? clip.canonical.means;
    stage.frame = frame;
    this.#shown = stage;
    this.#dirty = true;
    this.#sort(stage);
    return true;
  }

  /** Draw, if anything has changed and the GPU has finished the picture before. True: a picture was drawn. */
  draw(): boolean {
    if (!this.#dirty || !this.#shown || !this.#view || !this.#renderer || this.#renderer.busy) return false;
    const { width, height } = this.#size;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.#dirty = !this.#renderer.draw(this.#shown.scene, cameraOf(this.#view, width, height));
    return !this.#dirty;
  }

  /** What the last picture shows of each Gaussian; null: there is none. */
  read(): Drawn | null {
    const { width, height } = this.canvas;
    if (!this.#shown || !this.#view) return null;
    return this.#renderer?.read(this.#shown.scene, cameraOf(this.#view, width, height)) ?? null;
  }

  /** Draw for eyes around the view, whatever has changed: a headset forgets its pictures. True: they were drawn. */
  drawEyes(eyes: readonly Eye[]): boolean {
    const [renderer, scene] = [this.#renderer, this.#shown?.scene];
    if (!renderer || !scene) return false;
    return eyes.every(({ camera, surface }) => renderer.draw(scene, camera, surface));
  }

  /** Free the scenes of all canonical spaces but these and the one on the screen. */
  retain(spaces: ReadonlySet<Canonical>): void {
    for (const [canonical, stage] of this.#stages) {
      if (spaces.has(canonical) || this.#shown === stage) continue;
      this.#renderer?.free(stage.scene);
      this.#sorter.forget(stage.key);
      this.#stages.delete(canonical);
    }
  }

  close(): void {
    this.#end.abort();
    this.#sorter.close();
    this.#renderer?.dispose();
    this.#renderer = null;
    this.#stages.clear();
    this.#shown = null;
  }

  #makeRenderer(): Renderer {
    const { region, sh_degree } = this.tables.root;
    const [r = 0, g = 0, b = 0] = region.background ?? [];
    const renderer = new Renderer(this.canvas, { background: [r, g, b], target: this.options.target });
    renderer.prepare(sh_degree);
    return renderer;
  }

  /** Makes ready what a group begins with, so that its first frame can follow the one before without a pause. */
  prepare({ canonical, frames }: Clip): Stage | null {
    const known = this.#stages.get(canonical);
    if (known || !this.#renderer) return known ?? null;
    const scene = this.#renderer.scene(this.tables.root, this.tables.group(canonical.group), canonical);
    const means = frames.find((frame) => frame?.means.length)?.means ?? canonical.means;
    const key = `${this.#made++}`;
    const stage: Stage = { key, canonical, scene, clip: null, frame: -1, means };
    this.#stages.set(canonical, stage);
    this.#sort(stage);
    return stage;
  }

  /** Ask for the order of a stage; of those that wait, the sorter answers the newest question alone. */
  async #sort(stage: Stage): Promise<void> {
    if (!this.#view) return;
    const { means } = stage;
    stage.means = null;
    const rows = await this.#sorter.order(means, stage.key, cameraOf(this.#view, 1, 1));
    if (!rows || this.#stages.get(stage.canonical) !== stage || !this.#renderer) return;
    stage.scene.sort(rows);
    this.#dirty ||= this.#shown === stage;
  }
}
