// The picture that splats are blended into, before it goes to the canvas.
import { framebuffer, type Texture, texture } from "./textures.ts";

/** Half floats take an extension; every WebGL2 blends into ten bits, which cost a few dB. Ten bits begin at the
 * background, since their α has but two, and end at BRIGHTEST, since Gaussians may be brighter than the picture that
 * they make.
 */
export type TargetFormat = "rgba16f" | "rgb10_a2";

const BRIGHTEST = 1.5; // of 1, 1.5 and 2 it has the best worst picture of random Gaussians

type Colour = readonly [number, number, number];

/** The wanted format, or the one that this browser can blend into. */
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
