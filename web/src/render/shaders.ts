// GLSL that passes over rows share, the passes that make the canonical space of a group (FORMAT.md, sections 4 and 5),
// and those that draw: projected rows as parallelograms, blended far to near, and the picture on the canvas.
//
// A pass over rows draws one triangle over the row textures: each fragment is a row. Attributes are stored as the bits of
// floats in RGBA32UI textures, which core WebGL2 can draw into.
import { ALPHA_MAX, BLOCK, DELTA_AT, ESCAPE_UNIT, GREY, KEYFRAME_AT, SMALL_ANGLE } from "../generated/constants.ts";

/** Rows a line of the row textures. With as many lines, which every WebGL2 of today has, they hold 2^24 rows. */
export const ROW_WIDTH = 4096;
/** Colour layers that one pass draws: as many targets as every WebGL2 has. */
export const LAYERS_A_PASS = 4;

export const HEAD = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
precision highp usampler2D; precision highp usampler2DArray; precision highp isampler2DArray;
uniform float time; // how often slopes count; 0 but for states
`;

/** GLSL of three channels of a code table, `first` and those after it, at a sample. */
export const three = (first: number) =>
  `vec3(${[0, 1, 2].map((axis) => `decode(entries[${first + axis}], at)`).join(", ")})`;

export const size = ({ log_scales, opacity }: { log_scales: number; opacity: number }) =>
  `vec4(${three(log_scales)}, decode(entries[${opacity}], at))`;

export const WHOLE = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

export const each = (count: number, text: (layer: number) => string) =>
  Array.from({ length: count }, (_, l) => text(l)).join("\n");

// An entry of a code table (codes.ts) is the corner of a plane, its x -1 without a plane, the centre, and the step's
// bits.
export const CODES = `
uniform usampler2DArray luma; uniform isampler2DArray bases;
uniform ivec2 layout_; // blocks side by side in a plane, lines of a picture
uniform bool escaped;
ivec2 place(int row) {
  int block = row >> 8, cell = row & 255;
  ivec2 at = ivec2((cell & 1) | (cell >> 1 & 2) | (cell >> 2 & 4) | (cell >> 3 & 8),
                   (cell >> 1 & 1) | (cell >> 2 & 2) | (cell >> 3 & 4) | (cell >> 4 & 8));
  return ivec2(block % layout_.x, block / layout_.x) * ${BLOCK} + at;
}
float decode(ivec4 entry, ivec2 at) {
  int code = entry.z;
  float rise = 0.0;
  if (entry.x >= 0) {
    ivec2 t = at + entry.xy;
    ivec3 s = ivec3(t.x, t.y % layout_.y, t.y / layout_.y);
    code += int(texelFetch(luma, s, 0).r) - ${GREY};
    if (escaped) {
      ivec2 more = texelFetch(bases, s, 0).rg;
      code += ${ESCAPE_UNIT} * more.x;
      rise = time * float(more.y);
    }
  }
  return (float(code) + rise) * intBitsToFloat(entry.w);
}
`;

export const TURNS = `
vec4 turn(vec3 v) { // rotation vector -> quaternion w x y z
  float angle = length(v);
  return vec4(cos(0.5 * angle), v * (angle > ${SMALL_ANGLE} ? sin(0.5 * angle) / angle : 0.5)); // in float32
}
vec4 product(vec4 p, vec4 q) { // turns by q first
  return vec4(p.x * q.x - dot(p.yzw, q.yzw), p.x * q.yzw + q.x * p.yzw + cross(p.yzw, q.yzw));
}
`;

/** GLSL for a second picture, of what differs from the first: each name of it ends in 2. */
const second = (text: string) =>
  text.replace(/\b(at|place|decode|luma|bases|layout_|escaped|entries|tint[CAs]\w*)\b/g, "$&2");
const both = (text: string) => text + second(text);

/** A picture shows span.y rows of the group from row span.x on. -1: not one of them. */
const ROW = `
uniform ivec2 span;
int row() {
  int i = int(gl_FragCoord.y) * ${ROW_WIDTH} + int(gl_FragCoord.x) - span.x;
  return i < span.y ? i : -1;
}
`;

export const KEYFRAME_GEOMETRY = `${HEAD}${both(CODES)}${TURNS}${ROW}
uniform ivec4 entries[${KEYFRAME_AT.colour}], entries2[${DELTA_AT.colour}];
uniform float unit; // ln of that of the grid
layout(location = 0) out uvec4 rotation;
layout(location = 1) out uvec4 size;
void main() {
  int i = row();
  if (i < 0) discard;
  ${both("ivec2 at = place(i);")}
  rotation = floatBitsToUint(product(turn(${second(three(DELTA_AT.quaternions))}), turn(${three(KEYFRAME_AT.quaternions)})));
  size = floatBitsToUint(vec4(vec3(unit), 0.0) + ${size(KEYFRAME_AT)} + ${second(size(DELTA_AT))});
}`;

/** Colour channels that may differ from 0: their code table, and which line of the transform each is. */
export const tints = (channels: number) =>
  `uniform ivec4 tints[${channels}]; uniform int tintChannels[${channels}], tintCount;`;
export const COLOURS = "uniform sampler2D transform; uniform vec2 tintSteps;"; // of SH DC and of SH rest

/** Layer l holds the colours 4 l to 4 l + 3: the first three are SH DC. */
export const layerSteps = (layer: number) => (layer ? "tintSteps.y" : "vec4(tintSteps.xxx, tintSteps.y)");

export const keyframeColours = (
  channels: number,
  first: number,
  count: number,
) => `${HEAD}${both(CODES + tints(channels))}${COLOURS}${ROW}
${each(count, (l) => `layout(location = ${l}) out uvec4 layer${l};`)}
void main() {
  int i = row();
  if (i < 0) discard;
  ${each(count, (l) => `vec4 sum${l} = vec4(0.0);`)}
  ${both(`ivec2 at = place(i);
  for (int n = 0; n < tintCount; n++) {
    float y = decode(tints[n], at);
    ${each(count, (l) => `sum${l} += y * texelFetch(transform, ivec2(${first + l}, tintChannels[n]), 0);`)}
  }`)}
  ${each(count, (l) => `layer${l} = floatBitsToUint(sum${l} * ${layerSteps(first + l)});`)}
}`;

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
uniform ivec2 corner; // of the picture on the surface
out vec4 colour;
void main() {
  vec4 p = texelFetch(picture, ivec2(gl_FragCoord.xy) - corner, 0);
  colour = vec4(p.rgb * brightest + (1.0 - p.a) * background, 1.0);
}`;
