// A package in a scene of PlayCanvas.
//
//     index.html?src=PACKAGE/[&rung=Q1+L0][&frame=12]      the last one stands still
import {
  Application,
  Color,
  Entity,
  FILLMODE_FILL_WINDOW,
  Quat,
  RESOLUTION_AUTO,
  TONEMAP_NONE,
  Vec3,
} from "playcanvas";
import { CameraControls } from "playcanvas/scripts/esm/camera-controls.mjs";
import { type FrameReader, openFrames } from "../../src/airgs-frames.ts";
import { AirgsSplats, tuneGsplat } from "./airgs-splats.ts";

const query = new URLSearchParams(location.search);
const canvas = document.querySelector("canvas")!;
const output = document.querySelector("output")!;

function startApp(): Application {
  const app = new Application(canvas, { graphicsDeviceOptions: { antialias: false } }); // splats have soft edges
  app.setCanvasFillMode(FILLMODE_FILL_WINDOW);
  app.setCanvasResolution(RESOLUTION_AUTO);
  app.graphicsDevice.maxPixelRatio = devicePixelRatio;
  addEventListener("resize", () => app.resizeCanvas());
  tuneGsplat(app);
  app.start();
  return app;
}

/**
 * Puts a camera where the first place of the viewing region is, to be turned round the focus of that place.
 *
 * Controls of PlayCanvas keep y up. What is up in the package is turned to there, splats and camera alike.
 */
function firstView(app: Application, { region }: FrameReader, splats: Entity): void {
  const { position, focus, up } = region.places[0]!;
  const turn = new Quat().setFromDirections(new Vec3(up).normalize(), Vec3.UP);
  splats.setRotation(turn);
  const camera = new Entity("camera");
  const clip = { nearClip: region.near, farClip: region.near * 1e6 };
  camera.addComponent("camera", { clearColor: Color.BLACK, fov: region.fov_y, toneMapping: TONEMAP_NONE, ...clip });
  camera.setPosition(turn.transformVector(new Vec3(position)));
  app.root.addChild(camera);
  camera.addComponent("script");
  const controls = camera.script!.create(CameraControls) as CameraControls;
  controls.enableFly = false;
  controls.focusPoint = turn.transformVector(new Vec3(focus));
}

/** Shows the frame whose time it is, over and over again. */
async function play(reader: FrameReader, splats: AirgsSplats): Promise<void> {
  const still = query.get("frame");
  const start = performance.now();
  for (let shown = -1; ; await new Promise(requestAnimationFrame)) {
    const passed = Math.floor(((performance.now() - start) / 1000) * reader.fps);
    const frame = still === null ? passed % reader.frames : Number(still);
    if (frame === shown) continue;
    splats.show(await reader.gaussians(frame, query.get("rung") ?? undefined));
    output.textContent = `frame ${frame + 1} of ${reader.frames}`;
    shown = frame;
  }
}

async function main(): Promise<void> {
  const reader = await openFrames(query.get("src") ?? "./");
  const app = startApp();
  const splats = new AirgsSplats(app);
  app.root.addChild(splats.entity);
  firstView(app, reader, splats.entity);
  await play(reader, splats);
}

main().catch((error) => {
  output.textContent = String(error);
});
