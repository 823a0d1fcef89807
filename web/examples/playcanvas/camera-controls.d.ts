// The engine's script has no types of its own.
declare module "playcanvas/scripts/esm/camera-controls.mjs" {
  import { Script, type Vec3 } from "playcanvas";

  export class CameraControls extends Script {
    enableFly: boolean;
    focusPoint: Vec3;
  }
}
