// GLSL that passes over rows share, and the passes that make the canonical space of a group (FORMAT.md, sections 4 and
// 5).
//
// A pass over rows draws one triangle over the row textures: each fragment is a row. Attributes are stored as the bits of
// floats in RGBA32UI textures, which core WebGL2 can draw into.
import { BLOCK, ESCAPE_UNIT, GREY, KEY_AT, SMALL_ANGLE } from "../generated/constants.ts";

/** Rows a line of the row textures. With as many lines, which every WebGL2 of today has, they hold 2^24 rows. */
export const ROW_WIDTH = 4096;
/** Colour layers that one pass draws: as many targets as every WebGL2 has. */
export const LAYERS_A_PASS = 4;

export const HEAD = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
precision highp usampler2D; precision highp usampler2DArray; precision highp isampler2DArray;
`;

/** GLSL of three channels of a code table, `first` and those after it, at a sample. */
export const three = (first: number) =>
  `vec3(${[0, 1, 2].map((axis) => `decode(entries[${first + axis}], at)`).join(", ")})`;

/** A triangle that covers the target. */
export const WHOLE = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

/** Text for each of a number of layers. */
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
  if (entry.x >= 0) {
    ivec2 t = at + entry.xy;
    ivec3 s = ivec3(t.x, t.y % layout_.y, t.y / layout_.y);
    code += int(texelFetch(luma, s, 0).r) - ${GREY};
    if (escaped) code += ${ESCAPE_UNIT} * texelFetch(bases, s, 0).r;
  }
  return float(code) * intBitsToFloat(entry.w);
}
vec4 turn(vec3 v) { // rotation vector -> quaternion w x y z
  float angle = length(v);
  return vec4(cos(0.5 * angle), v * (angle > ${SMALL_ANGLE} ? sin(0.5 * angle) / angle : 0.5)); // below, both are 1/2 in float32
}
`;

/** A picture shows span.y rows of the group from row span.x on: `picked` says which of its own. -1: not one of them. */
const ROW = `
uniform ivec2 span;
uniform usampler2D picked;
int row() {
  ivec2 t = ivec2(gl_FragCoord.xy);
  int i = t.y * ${ROW_WIDTH} + t.x - span.x;
  return i < 0 || i >= span.y ? -1 : int(texelFetch(picked, t, 0).r);
}
`;

export const KEY_GEOMETRY = `${HEAD}${CODES}${ROW}
uniform ivec4 entries[${KEY_AT.colour}];
layout(location = 0) out uvec4 rotation;
layout(location = 1) out uvec4 size;
void main() {
  int i = row();
  if (i < 0) discard;
  ivec2 at = place(i);
  rotation = floatBitsToUint(turn(${three(KEY_AT.quaternions)}));
  size = floatBitsToUint(vec4(${three(KEY_AT.log_scales)}, decode(entries[${KEY_AT.opacity}], at)));
}`;

/** Colour channels that may differ from 0: their code table, and which line of the transform each is. */
export const colours = (channels: number) => `
uniform ivec4 tints[${channels}]; uniform int tintChannels[${channels}]; uniform int tintCount;
uniform sampler2D transform; uniform vec2 tintSteps; // of SH DC and of SH rest
`;

/** Layer l holds the colours 4 l to 4 l + 3: the first three are SH DC. */
export const layerSteps = (layer: number) => (layer ? "tintSteps.y" : "vec4(tintSteps.xxx, tintSteps.y)");

/** The colour layers [first, first + count) of `channels` colours. */
export const keyColours = (channels: number, first: number, count: number) => `${HEAD}${CODES}${ROW}${colours(channels)}
${each(count, (l) => `layout(location = ${l}) out uvec4 layer${l};`)}
void main() {
  int i = row();
  if (i < 0) discard;
  ivec2 at = place(i);
  ${each(count, (l) => `vec4 sum${l} = vec4(0.0);`)}
  for (int n = 0; n < tintCount; n++) {
    float y = decode(tints[n], at);
    ${each(count, (l) => `sum${l} += y * texelFetch(transform, ivec2(${first + l}, tintChannels[n]), 0);`)}
  }
  ${each(count, (l) => `layer${l} = floatBitsToUint(sum${l} * ${layerSteps(first + l)});`)}
}`;
