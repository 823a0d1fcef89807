// Textures and framebuffers. All textures are read with texelFetch or written by passes: nothing is filtered.
import { ROW_WIDTH } from "./shaders.ts";

/** A renderer that cannot do what it is asked on this machine: one line that says what was expected and what came. */
export class RenderError extends Error {
  override name = "RenderError";
}

type Internal = keyof typeof LAYOUTS;

/** A texture with its size; `layers` 0: not an array. */
export interface Texture {
  readonly handle: WebGLTexture | null;
  readonly target: number;
  readonly internal: Internal;
  readonly width: number;
  readonly height: number;
  readonly layers: number;
}

export function texture(gl: WebGL2RenderingContext, internal: Internal, size: [number, number], layers = 0): Texture {
  const target = layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
  const [width, height] = size;
  const handle = gl.createTexture();
  gl.bindTexture(target, handle);
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  if (layers) gl.texStorage3D(target, 1, gl[internal], width, height, layers);
  else gl.texStorage2D(target, 1, gl[internal], width, height);
  return { handle, target, internal, width, height, layers };
}

interface Box {
  y: number;
  width: number;
  height: number;
  layer?: number;
}

/** Writes texels, line after line, from `offset` in `data` on. */
export function write(gl: WebGL2RenderingContext, to: Texture, box: Box, data: ArrayBufferView, offset = 0): void {
  const { y, width, height, layer = 0 } = box;
  const [format, type] = LAYOUTS[to.internal].map((name) => gl[name]);
  gl.bindTexture(to.target, to.handle);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  if (to.layers) gl.texSubImage3D(to.target, 0, 0, y, layer, width, height, 1, format, type, data, offset);
  else gl.texSubImage2D(to.target, 0, 0, y, width, height, format, type, data, offset);
}

const LAYOUTS = {
  R8UI: ["RED_INTEGER", "UNSIGNED_BYTE"],
  RG32I: ["RG_INTEGER", "INT"],
  R32UI: ["RED_INTEGER", "UNSIGNED_INT"],
  RGBA32UI: ["RGBA_INTEGER", "UNSIGNED_INT"],
  RGBA32F: ["RGBA", "FLOAT"],
  RGBA16F: ["RGBA", "HALF_FLOAT"],
  RGB10_A2: ["RGBA", "UNSIGNED_INT_2_10_10_10_REV"],
} as const;

/** Writes the first rows of a row texture: `data` has `components` numbers a row. */
export function writeRows(gl: WebGL2RenderingContext, to: Texture, data: Uint32Array, components = 1): void {
  const rows = data.length / components;
  const whole = Math.floor(rows / ROW_WIDTH);
  const rest = rows % ROW_WIDTH;
  if (whole) write(gl, to, { y: 0, width: ROW_WIDTH, height: whole }, data);
  if (rest) write(gl, to, { y: whole, width: rest, height: 1 }, data, whole * ROW_WIDTH * components);
}

/** A framebuffer that draws into textures, or into layers of one. Nobody asks whether it is complete, which would wait
 * for all that the GPU has yet to do: core WebGL2 draws into all formats here but RGBA16F.
 */
export function framebuffer(gl: WebGL2RenderingContext, into: Texture[], layers?: number[]): WebGLFramebuffer {
  const made = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, made);
  into.forEach(({ handle }, i) => {
    const at = gl.COLOR_ATTACHMENT0 + i;
    if (layers) gl.framebufferTextureLayer(gl.FRAMEBUFFER, at, handle, 0, layers[i]);
    else gl.framebufferTexture2D(gl.FRAMEBUFFER, at, gl.TEXTURE_2D, handle, 0);
  });
  gl.drawBuffers(into.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
  return made;
}

/** Half floats take an extension; every WebGL2 blends into ten bits, which cost a few dB. Ten bits begin at the
 * background, since their α has but two, and end at BRIGHTEST, since Gaussians may be brighter than the picture that
 * they make.
 */
export type TargetFormat = "rgba16f" | "rgb10_a2";

const BRIGHTEST = 1.5; // of 1, 1.5 and 2 it has the best worst picture of random Gaussians

type Colour = readonly [number, number, number];

export function targetFormat(gl: WebGL2RenderingContext, wanted: TargetFormat): TargetFormat {
  if (wanted === "rgb10_a2") return wanted;
  if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) return "rgb10_a2";
  const tried = new Target(gl, "rgba16f", [1, 1]);
  const complete = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
  tried.free();
  return complete ? "rgba16f" : "rgb10_a2";
}

export class Target {
  readonly picture: Texture;
  readonly handle: WebGLFramebuffer;
  readonly floats: boolean;
  readonly brightest: number;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    format: TargetFormat,
    size: [number, number],
  ) {
    this.floats = format === "rgba16f";
    this.brightest = this.floats ? 1 : BRIGHTEST;
    this.picture = texture(gl, this.floats ? "RGBA16F" : "RGB10_A2", size);
    this.handle = framebuffer(gl, [this.picture]);
  }

  clear(background: Colour): void {
    const { gl } = this;
    const { width, height } = this.picture;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.handle);
    gl.viewport(0, 0, width, height);
    const [r, g, b] = this.floats ? [0, 0, 0] : background;
    gl.clearColor(r / this.brightest, g / this.brightest, b / this.brightest, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** The colour behind the picture that α lets through; black where it is part of the picture. */
  behind(background: Colour): Colour {
    return this.floats ? background : [0, 0, 0];
  }

  free(): void {
    this.gl.deleteTexture(this.picture.handle);
    this.gl.deleteFramebuffer(this.handle);
  }
}
