// The passes that draw: projected rows as parallelograms, blended far to near, and the picture on the canvas.
import { ALPHA_MAX } from "../generated/constants.ts";
import { HEAD, ROW_WIDTH } from "./shaders.ts";

/** Parallelograms an instance: a GPU starves on four vertices each, and SwiftShader takes 13 µs an instance. */
export const QUADS = 128;

// Corners are rounded to parts of a pixel (16ths in SwiftShader), so they lie a little outside and what is drawn is
// worked out from the fragment's own place, not from what would be interpolated between them. y is up here.
export const SPLAT_VERTEX = `${HEAD}
uniform usampler2D firsts, seconds, order; // firsts and seconds: projection of project-shader.ts
uniform vec2 size;
uniform int visible;
flat out vec4 look; // r, g, b, reach
flat out vec4 ellipse; // centre, 1 / w, 1 / h
flat out float shear;
ivec2 texel(uint n) { return ivec2(n % ${ROW_WIDTH}u, n / ${ROW_WIDTH}u); }
void main() {
  look = ellipse = vec4(0.0);
  shear = 0.0;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside
  int n = gl_InstanceID * ${QUADS} + (gl_VertexID >> 2);
  if (n >= visible) return;
  ivec2 t = texel(texelFetch(order, texel(uint(n)), 0).r);
  uvec4 second = texelFetch(seconds, t, 0);
  if (second.y == 0u) return;
  vec4 first = uintBitsToFloat(texelFetch(firsts, t, 0));
  vec2 centre = vec2(first.x, size.y - first.y);
  shear = -uintBitsToFloat(second.x);
  ellipse = vec4(centre, 1.0 / first.zw);
  look = vec4(unpackHalf2x16(second.z), unpackHalf2x16(second.w).x, uintBitsToFloat(second.y));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  vec2 at = corner * (first.zw + 0.07 * vec2(1.0 + abs(shear), 1.0));
  gl_Position = vec4(2.0 * (centre + vec2(at.x + shear * at.y, at.y)) / size - 1.0, 0.0, 1.0);
}`;

export const SPLAT_FRAGMENT = `${HEAD}
flat in vec4 look;
flat in vec4 ellipse;
flat in float shear;
uniform float brightest; // what the target's largest number stands for
out vec4 colour;
void main() {
  vec2 d = gl_FragCoord.xy - ellipse.xy;
  vec2 uv = vec2(d.x - shear * d.y, d.y) * ellipse.zw;
  float far = dot(uv, uv);
  if (far > 1.0) discard; // less than 1/255
  float alpha = min(${ALPHA_MAX}, exp(look.w * (1.0 - far)) / 255.0);
  colour = vec4(look.rgb * (alpha / brightest), alpha);
}`;

export const SHOW = `${HEAD}
uniform sampler2D picture;
uniform vec3 background;
uniform float brightest;
out vec4 colour;
void main() {
  vec4 p = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
  colour = vec4(p.rgb * brightest + (1.0 - p.a) * background, 1.0);
}`;
