// A camera as the projection pass takes it.
import type { Camera } from "../format/types.ts";
import { MARGIN } from "../generated/constants.ts";
import type { InUse } from "./programs.ts";

/** Sets the uniforms of VIEW in project-shader.ts, for a picture of `size` pixels instead of the camera's. */
export function setView(gl: WebGL2RenderingContext, at: InUse["at"], camera: Camera, size: [number, number]): void {
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
