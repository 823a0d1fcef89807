// Luma pictures -> Gaussians -> a picture of them, in WebGL2. All arithmetic is done in passes over rows, but for the
// order.
//
// Passes: keyframe (once a scene), projection (once a picture or camera), splats, and the canvas. N rows of a group.
import { colourChannels } from "../format/steps.ts";
import type { Camera, Canonical, Group, Root } from "../format/types.ts";
import { Programs } from "./programs.ts";
import { projection, setView } from "./project-shader.ts";
import { prepareKeyframes, Scene, setCodes } from "./scene.ts";
import { QUADS, ROW_WIDTH, SHOW, SPLAT_FRAGMENT, SPLAT_VERTEX, WHOLE } from "./shaders.ts";
import { RenderError, Target, type TargetFormat, type Texture, targetFormat, texture } from "./textures.ts";

export { RenderError, Scene };

export interface RendererOptions {
  /** What splats are blended into; default "rgba16f" where the browser can. */
  target?: TargetFormat | undefined;
  /** r, g, b of 0 … 1 behind the Gaussians; default black. */
  background?: readonly [number, number, number];
}

/** Where a picture goes: a rectangle of a framebuffer (null: the canvas), pixels from its lower left corner. */
export interface Surface {
  framebuffer: WebGLFramebuffer | null;
  x: number;
  y: number;
  width: number;
  height: number;
}

/** What was drawn of each row, four numbers of each texel of `projection` (project-shader.ts), and by which camera. */
export interface Drawn {
  firsts: Float32Array;
  seconds: Float32Array;
  camera: Camera;
}

const SAMPLERS = ["luma", "bases", "transform", "places", "rotations", "sizes", "ranks", "layers"];
const PROJECTION = "projection ";

/** Draws scenes into a canvas, of whatever size the canvas has.
 *
 * After the context was lost its methods do nothing; make a new one, with new scenes, when it was restored, which the
 * renderer asks the browser for.
 */
export class Renderer {
  background: readonly [number, number, number];
  readonly target: TargetFormat;
  readonly #gl: WebGL2RenderingContext;
  readonly #programs: Programs;
  readonly #splats: WebGLVertexArrayObject | null;
  readonly #corners: WebGLBuffer | null;
  readonly #noLuma: Texture;
  readonly #noBases: Texture;
  readonly #onLost = (event: Event) => {
    event.preventDefault(); // then the browser restores it, for another renderer
    this.#wasLost = true;
    for (const scene of this.#scenes) scene.freed = true;
  };
  readonly #scenes = new Set<Scene>();
  #picture: Target | null = null;
  #drawing: WebGLSync | null = null;
  /** What it holds belongs to a context that was lost, even when that was restored. */
  #wasLost = false;
  #disposed = false;

  /** Throws RenderError where there is no WebGL2. */
  constructor(canvas: HTMLCanvasElement | OffscreenCanvas, options: RendererOptions = {}) {
    const wanted = { alpha: false, antialias: false, depth: false, stencil: false };
    const gl = canvas.getContext("webgl2", { ...wanted, powerPreference: "high-performance" });
    if (!(gl instanceof WebGL2RenderingContext)) throw new RenderError("a browser: expected WebGL2, got none");
    this.#gl = gl;
    this.background = options.background ?? [0, 0, 0];
    canvas.addEventListener("webglcontextlost", this.#onLost);
    this.#programs = new Programs(gl);
    this.target = targetFormat(gl, options.target ?? "rgba16f");
    this.#corners = gl.createBuffer();
    this.#splats = quads(gl, this.#corners);
    this.#noLuma = texture(gl, "R8UI", [1, 1], 1);
    this.#noBases = texture(gl, "RG32I", [1, 1], 1);
    const samplers = ["firsts", "seconds", "order"];
    this.#programs.prepare("splats", () => ({ vertex: SPLAT_VERTEX, fragment: SPLAT_FRAGMENT, samplers }));
    this.#programs.prepare("canvas", () => ({ vertex: WHOLE, fragment: SHOW, samplers: ["picture"] }));
  }

  get lost(): boolean {
    return this.#disposed || this.#wasLost || this.#gl.isContextLost();
  }

  /** Whether the GPU has not finished the last picture. On a slow machine, wait before the next. */
  get busy(): boolean {
    const gl = this.#gl;
    if (!this.#drawing || this.lost) return false;
    if (gl.getSyncParameter(this.#drawing, gl.SYNC_STATUS) !== gl.SIGNALED) return true;
    gl.deleteSync(this.#drawing);
    this.#drawing = null;
    return false;
  }

  /** Begins to compile what scenes of a degree of spherical harmonics need. */
  prepare(degree: number): void {
    if (this.lost) return;
    const source = () => ({ vertex: WHOLE, fragment: projection(degree, colourChannels(degree)), samplers: SAMPLERS });
    this.#programs.prepare(PROJECTION + degree, source);
    prepareKeyframes(this.#programs, degree);
  }

  /** A group, of which it shows the canonical space first. Throws RenderError for more than the textures here hold. */
  scene(root: Root, group: Group, canonical: Canonical): Scene {
    this.prepare(root.sh_degree);
    const scene = new Scene(this.#gl, root, group, canonical);
    scene.freed = this.lost;
    this.#scenes.add(scene);
    return scene;
  }

  /** Whether `draw` would draw it: it has an order, and its programs are compiled, after which the first to ask has the
   * keyframe passes run. Ask from time to time.
   */
  ready(scene: Scene): boolean {
    if (this.lost || scene.freed || !this.#finishKeyframes(scene) || !scene.ordered) return false;
    return this.#programs.done([PROJECTION + scene.degree, "splats", "canvas"]);
  }

  /** Draws a scene on a surface, by default the whole canvas, if it is ready; else the picture stays as it is. */
  draw(scene: Scene, camera: Camera, surface?: Surface): boolean {
    if (!this.ready(scene)) return false;
    const gl = this.#gl;
    const { drawingBufferWidth, drawingBufferHeight } = gl;
    const whole = { framebuffer: null, x: 0, y: 0, width: drawingBufferWidth, height: drawingBufferHeight };
    const { framebuffer, x, y, width, height } = surface ?? whole;
    this.#project(scene, camera, [width, height]);
    const held = this.#picture?.picture;
    if (held?.width !== width || held.height !== height) {
      this.#picture?.free();
      this.#picture = new Target(gl, this.target, [width, height]);
    }
    const picture = this.#picture!;
    picture.clear(this.background);
    this.#splat(scene, [width, height]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, width, height);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
    const at = this.#programs.use("canvas", [picture.picture]);
    gl.uniform2i(at("corner"), x, y);
    gl.uniform1f(at("brightest"), picture.brightest);
    gl.uniform3f(at("background"), ...picture.behind(this.background));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.deleteSync(this.#drawing);
    this.#drawing = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    return true;
  }

  /** What a camera drew last of a scene; null: nothing. It waits for the GPU. */
  read(scene: Scene, camera: Camera): Drawn | null {
    if (this.lost || scene.freed) return null;
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, scene.projection);
    const [firsts, seconds] = [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1].map((from) => {
      const texels = new Uint32Array(4 * ROW_WIDTH * scene.places.height);
      gl.readBuffer(from);
      gl.readPixels(0, 0, ROW_WIDTH, scene.places.height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, texels);
      return new Float32Array(texels.buffer);
    });
    return { firsts, seconds, camera };
  }

  free(scene: Scene): void {
    this.#scenes.delete(scene);
    if (this.lost) scene.freed = true;
    else scene.free();
  }

  get picture(): Target | null {
    return this.lost ? null : this.#picture;
  }

  dispose(): void {
    const gl = this.#gl;
    gl.canvas.removeEventListener("webglcontextlost", this.#onLost);
    for (const scene of this.#scenes) this.free(scene);
    if (this.lost) return;
    this.#disposed = true;
    this.#programs.free();
    this.#picture?.free();
    for (const { handle } of [this.#noLuma, this.#noBases]) gl.deleteTexture(handle);
    gl.deleteVertexArray(this.#splats);
    gl.deleteBuffer(this.#corners);
    gl.deleteSync(this.#drawing);
  }

  #finishKeyframes(scene: Scene): boolean {
    if (!scene.keyframes || this.lost) return !this.lost;
    if (!this.#programs.done(prepareKeyframes(this.#programs, scene.degree))) return false;
    scene.keyframes.run(this.#programs, this.#noLuma, this.#noBases);
    scene.keyframes = null;
    return true;
  }

  #project(scene: Scene, camera: Camera, size: [number, number]): void {
    const seen = [camera.near, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, ...size];
    const view = [...seen, ...camera.worldToCamera].join(" ");
    if (scene.projectedFor === view) return;
    scene.projectedFor = view;
    const gl = this.#gl;
    const shown = scene.moving ? scene.shown : null;
    const samples = shown?.samples;
    const { transform, places, rotations, sizes, ranks, layers } = scene;
    const textures = [samples?.luma ?? this.#noLuma, samples?.bases ?? this.#noBases, transform, places];
    const at = this.#programs.use(PROJECTION + scene.degree, [...textures, rotations, sizes, ranks, layers]);
    gl.uniform1i(at("rows"), scene.rows);
    gl.uniform1f(at("time"), scene.time);
    gl.uniform1i(at("moving"), shown ? 1 : 0);
    if (shown) setCodes(gl, at, shown.codes, shown.samples);
    gl.uniform2f(at("tintSteps"), ...scene.tintSteps);
    setView(gl, at, camera, size);
    gl.bindFramebuffer(gl.FRAMEBUFFER, scene.projection);
    gl.viewport(0, 0, ROW_WIDTH, scene.places.height);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #splat(scene: Scene, [width, height]: [number, number]): void {
    if (!scene.visible) return;
    const gl = this.#gl;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.#splats);
    const at = this.#programs.use("splats", [scene.firsts, scene.seconds, scene.order]);
    gl.uniform2f(at("size"), width, height);
    gl.uniform1i(at("visible"), scene.visible);
    gl.uniform1f(at("brightest"), this.#picture!.brightest);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * QUADS, gl.UNSIGNED_SHORT, 0, Math.ceil(scene.visible / QUADS));
  }
}

function quads(gl: WebGL2RenderingContext, corners: WebGLBuffer | null): WebGLVertexArrayObject | null {
  const all = Uint16Array.from({ length: 6 * QUADS }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
  const made = gl.createVertexArray();
  gl.bindVertexArray(made);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, all, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return made;
}
