// The pass from rows to what is drawn of them: state, projection and colour of a frame as a camera sees it.
//
// The arithmetic is that of airgs_codec/render/cpu_kernels.py. The covariance of the picture is [[xx, xy], [xy, yy]]
// px²; its determinant is taken by Cauchy-Binet, whose terms do not cancel.
import type { Camera } from "../format/types.ts";
import { DELTA_AT, DILATION, MARGIN, OPACITY_MARGIN, SH_C0, SH_C1, SH_C2, SH_C3 } from "../generated/constants.ts";
import type { Uniforms } from "./programs.ts";
import { CODES, COLOURS, each, HEAD, layerSteps, ROW_WIDTH, size, TURNS, three, tints } from "./shaders.ts";

// The signs are those of INRIA's files; FORMAT.md, section 5. d: direction from the viewer, dd: its squares.
const BASIS = [
  [`${SH_C0}`],
  [`-${SH_C1} * d.y`, `${SH_C1} * d.z`, `-${SH_C1} * d.x`],
  [
    `${SH_C2[0]} * d.x * d.y`,
    `${SH_C2[1]} * d.y * d.z`,
    `${SH_C2[2]} * (2.0 * dd.z - dd.x - dd.y)`,
    `${SH_C2[3]} * d.x * d.z`,
    `${SH_C2[4]} * (dd.x - dd.y)`,
  ],
  [
    `${SH_C3[0]} * d.y * (3.0 * dd.x - dd.y)`,
    `${SH_C3[1]} * d.x * d.y * d.z`,
    `${SH_C3[2]} * d.y * (4.0 * dd.z - dd.x - dd.y)`,
    `${SH_C3[3]} * d.z * (2.0 * dd.z - 3.0 * dd.x - 3.0 * dd.y)`,
    `${SH_C3[4]} * d.x * (4.0 * dd.z - dd.x - dd.y)`,
    `${SH_C3[5]} * d.z * (dd.x - dd.y)`,
    `${SH_C3[6]} * d.x * (dd.x - 3.0 * dd.y)`,
  ],
];

const ATTRIBUTES = `
uniform usampler2D places, rotations, sizes, ranks;
uniform usampler2DArray layers;
uniform int rows;
uniform bool moving; // else the canonical space is shown
uniform ivec4 entries[${DELTA_AT.colour}];
`;

// What is nearer than `near` is not drawn. The Jacobian is taken inside `bounds`: x, then y, of z = 1.
const VIEW = `
uniform vec3 right, down, ahead, eye, eyeRest; // eyeRest: what float32 takes off the position
uniform vec4 lens, bounds; // fx, fy, cx, cy
uniform vec2 size;
uniform float near;
`;

const SPACE = `
mat3 axes(vec4 q) { // columns of the rotation
  return mat3(1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
              2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
              2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
}
`;

/** The coefficients of a row: those of the canonical space, and what the state adds. */
function coefficients(layers: number): string {
  return `
vec4 u[${layers}];
void colour(ivec2 t, bool moved, ivec2 at) {
  ${each(layers, (l) => `u[${l}] = uintBitsToFloat(texelFetch(layers, ivec3(t, ${l}), 0));`)}
  if (!moved || tintCount == 0) return;
  ${each(layers, (l) => `vec4 sum${l} = vec4(0.0);`)}
  for (int n = 0; n < tintCount; n++) {
    float y = decode(tints[n], at);
    if (y == 0.0) continue;
    int k = tintChannels[n];
    ${each(layers, (l) => `sum${l} += y * texelFetch(transform, ivec2(${l}, k), 0);`)}
  }
  ${each(layers, (l) => `u[${l}] += sum${l} * ${layerSteps(l)};`)}
}
`;
}

function harmonics(degree: number): string {
  const coefficient = (n: number, axis: number) => `u[${(3 * n + axis) >> 2}].${"xyzw"[(3 * n + axis) & 3]}`;
  const terms = BASIS.slice(0, degree + 1).flat();
  return terms
    .map((basis, n) => `rgb += ${basis} * vec3(${coefficient(n, 0)}, ${coefficient(n, 1)}, ${coefficient(n, 2)});`)
    .join("\n  ");
}

/** The program that finds what is drawn of a row: two texels, of which the second's y is 0 where nothing is.
 *
 * With reach = ln(255 α) and the Cholesky form power = −(d² / w² + dy² / h²) · reach, d = dx − shear · dy, the
 * parallelogram (u, v) in [−1, 1]², dy = h v, d = w u bounds where α is 1/255 or more. first: its centre, w and h;
 * second: shear, reach; in half floats the colour, and the binary logarithm of the depth.
 */
export function projection(degree: number, channels: number): string {
  const layers = Math.ceil(channels / 4);
  return `${HEAD}${CODES}${TURNS}${tints(channels)}${COLOURS}${ATTRIBUTES}${VIEW}${SPACE}${coefficients(layers)}
layout(location = 0) out uvec4 first;
layout(location = 1) out uvec4 second;
void main() {
  first = uvec4(0u);
  second = uvec4(0u);
  ivec2 t = ivec2(gl_FragCoord.xy), at = ivec2(0);
  if (t.y * ${ROW_WIDTH} + t.x >= rows) return;
  vec4 p = uintBitsToFloat(texelFetch(places, t, 0)), s = uintBitsToFloat(texelFetch(sizes, t, 0));
  vec3 away = (p.xyz - eye) - eyeRest;
  uint rank = moving ? texelFetch(ranks, t, 0).r : 0xffffffffu;
  bool moved = rank != 0xffffffffu;
  if (moved) {
    at = place(int(rank));
    away += ${three(DELTA_AT.means)} * p.w;
    s += ${size(DELTA_AT)};
  }
  float alpha = clamp(s.w, ${OPACITY_MARGIN}, ${1 - OPACITY_MARGIN}); // FORMAT.md, section 5
  vec3 seen = vec3(dot(right, away), dot(down, away), dot(ahead, away));
  if (!(seen.z > near) || !(alpha * 255.0 > 1.0)) return;
  vec4 q = uintBitsToFloat(texelFetch(rotations, t, 0));
  if (moved) q = normalize(product(turn(${three(DELTA_AT.quaternions)}), q));
  vec2 uv = seen.xy / seen.z, inside = clamp(uv, bounds.xz, bounds.yw);
  mat3 R = axes(q);
  vec3 scale = exp(s.xyz);
  vec3 mx = (lens.x / seen.z * (right - inside.x * ahead)) * R * scale;
  vec3 my = (lens.y / seen.z * (down - inside.y * ahead)) * R * scale;
  vec3 minors = cross(mx, my);
  float xx = dot(mx, mx), yy = dot(my, my), xy = dot(mx, my);
  float det = dot(minors, minors) + ${DILATION} * (xx + yy) + ${DILATION ** 2}; // as the covariance is dilated
  xx += ${DILATION};
  yy += ${DILATION};
  if (!(det > 0.0 && det < 1e30)) return;
  float reach = log(255.0 * alpha);
  vec2 centre = lens.xy * uv + lens.zw, extent = sqrt(2.0 * reach * vec2(xx, yy));
  if (any(lessThanEqual(centre + extent, vec2(0.0))) || any(greaterThanEqual(centre - extent, size))) return;
  colour(t, moved, at);
  vec3 d = normalize(away), dd = d * d, rgb = vec3(0.5);
  ${harmonics(degree)}
  if (!(dot(abs(rgb), vec3(1.0)) < 1e6)) return;
  rgb = clamp(rgb, 0.0, 65504.0); // the largest half float
  first = floatBitsToUint(vec4(centre, sqrt(2.0 * reach * det / yy), sqrt(2.0 * reach * yy)));
  uvec2 tint = uvec2(packHalf2x16(rgb.rg), packHalf2x16(vec2(rgb.b, log2(seen.z))));
  second = uvec4(floatBitsToUint(vec2(xy / yy, reach)), tint);
}`;
}

/** Sets the uniforms of VIEW, for a picture of `size` pixels instead of the camera's. */
export function setView(gl: WebGL2RenderingContext, at: Uniforms, camera: Camera, size: [number, number]): void {
  const [width, height] = size;
  const m = camera.worldToCamera;
  const [x, y] = [width / camera.width, height / camera.height];
  const [fx, fy, cx, cy] = [camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y];
  const eye = [0, 1, 2].map((axis) => -(m[axis] * m[3] + m[4 + axis] * m[7] + m[8 + axis] * m[11]));
  const near32 = eye.map(Math.fround);
  gl.uniform3f(at("right"), m[0], m[1], m[2]);
  gl.uniform3f(at("down"), m[4], m[5], m[6]);
  gl.uniform3f(at("ahead"), m[8], m[9], m[10]);
  gl.uniform3fv(at("eye"), near32);
  gl.uniform3fv(
    at("eyeRest"),
    eye.map((value, axis) => value - near32[axis]),
  );
  gl.uniform4f(at("lens"), fx, fy, cx, cy);
  const [left, top] = [-cx - MARGIN * width, -cy - MARGIN * height];
  gl.uniform4f(
    at("bounds"),
    left / fx,
    (left + (1 + 2 * MARGIN) * width) / fx,
    top / fy,
    (top + (1 + 2 * MARGIN) * height) / fy,
  );
  gl.uniform2f(at("size"), width, height);
  gl.uniform1f(at("near"), camera.near);
}
