// What a renderer has drawn, as numbers; the top line first.
import type { Renderer } from "../../src/render/renderer.ts";

/** (4 · width · height) r, g, b, 1 of what was drawn last, neither clipped nor rounded to 8 bits. */
export function readFloat({ picture, background }: Renderer, canvas: HTMLCanvasElement): Float32Array {
  if (!picture) return new Float32Array(0);
  const gl = canvas.getContext("webgl2")!;
  const { floats, brightest, handle } = picture;
  const { width, height } = picture.picture;
  const raw = floats ? new Float32Array(4 * width * height) : new Uint32Array(width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, handle);
  gl.readPixels(0, 0, width, height, gl.RGBA, floats ? gl.FLOAT : gl.UNSIGNED_INT_2_10_10_10_REV, raw);
  const out = new Float32Array(4 * width * height).fill(1);
  const behind = picture.behind(background);
  for (let i = 0; i < out.length; i += 4) {
    for (let c = 0; c < 3; c++) {
      const bits = (raw[i / 4] >> (10 * c)) & 1023;
      out[i + c] = floats ? raw[i + c] + (1 - raw[i + 3]) * behind[c] : (bits / 1023) * brightest;
    }
  }
  return flipped(out, new Float32Array(out.length), 4 * width);
}

/** (4 · width · height) r, g, b, 255 of the canvas; in the same task as `draw`. */
export function readBytes(renderer: Renderer, canvas: HTMLCanvasElement): Uint8Array {
  if (renderer.lost) return new Uint8Array(0);
  const gl = canvas.getContext("webgl2")!;
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const raw = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, raw);
  return flipped(raw, new Uint8Array(raw.length), 4 * width);
}

/** Lines of `width` numbers in the other order, into `out`. */
function flipped<T extends Float32Array | Uint8Array>(from: T, out: T, width: number): T {
  for (let at = 0; at < from.length; at += width) out.set(from.subarray(at, at + width), from.length - width - at);
  return out;
}
