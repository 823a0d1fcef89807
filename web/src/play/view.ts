// Where a viewer stands, and the camera that a canvas of some size makes of it.
import type { Camera } from "../format/types.ts";
import { across, cross, dot, type Vector } from "../format/vector.ts";

/** Who looks from where; vectors are of length 1, positions in world units. */
export interface ViewState {
  position: Vector;
  forward: Vector;
  up: Vector;
  /** Vertical field of view in degrees. */
  fovY: number;
  /** What is nearer is not drawn, world units. */
  near: number;
}

/** The camera of a picture of `width` × `height` pixels. */
export function cameraOf(view: ViewState, width: number, height: number): Camera {
  const right = cross(view.forward, across(view.up, view.forward));
  const down = cross(view.forward, right);
  const worldToCamera = new Float64Array(16);
  [right, down, view.forward].forEach((axis, line) => {
    worldToCamera.set([...axis, -dot(axis, view.position)], 4 * line);
  });
  worldToCamera[15] = 1;
  const focal = height / 2 / Math.tan((view.fovY * Math.PI) / 360);
  return { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, near: view.near, worldToCamera };
}
