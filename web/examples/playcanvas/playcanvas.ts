// A package in a scene of PlayCanvas.
import { type FrameReader, openFrames } from "airgs-player/frames";
import { AirgsSplats, tuneGsplat } from "airgs-player/playcanvas";
import {
  Application,
  Color,
  Entity,
  FILLMODE_FILL_WINDOW,
  Mat4,
  Quat,
  RESOLUTION_AUTO,
  TONEMAP_NONE,
  Vec3,
} from "playcanvas";
import { CameraControls } from "playcanvas/scripts/esm/camera-controls.mjs";
import { canvas, play, run, src } from "../show.ts";

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

/** Puts splats where the package says that the scene stands; without that, what is up at its first place is y. */
function placeInWorld(splats: Entity, { region, world }: FrameReader): void {
  if (!world) {
    splats.setRotation(new Quat().setFromDirections(new Vec3(region.places[0]!.up).normalize(), Vec3.UP));
    return;
  }
  const t = world.transform as number[];
  const matrix = new Mat4().set(
    [0, 1, 2, 3].flatMap((column) => [t[column]!, t[column + 4]!, t[column + 8]!, column < 3 ? 0 : 1]),
  );
  splats.setPosition(matrix.getTranslation());
  splats.setRotation(new Quat().setFromMat4(matrix));
  splats.setLocalScale(matrix.getScale());
}

/**
 * Puts a camera where the first place of the viewing region is, to be turned round the focus of that place.
 *
 * Controls of PlayCanvas keep y up, which is where the splats were turned to.
 */
function firstView(app: Application, { region }: FrameReader, splats: Entity): void {
  const { position, focus } = region.places[0]!;
  const matrix = splats.getWorldTransform();
  const near = region.near * matrix.getScale().x;
  const camera = new Entity("camera");
  const clip = { nearClip: near, farClip: near * 1e6 };
  camera.addComponent("camera", { clearColor: Color.BLACK, fov: region.fov_y, toneMapping: TONEMAP_NONE, ...clip });
  camera.setPosition(matrix.transformPoint(new Vec3(position)));
  app.root.addChild(camera);
  camera.addComponent("script");
  const controls = camera.script!.create(CameraControls) as CameraControls;
  controls.enableFly = false;
  controls.focusPoint = matrix.transformPoint(new Vec3(focus));
}

run(async () => {
  const reader = await openFrames(src);
  const app = startApp();
  const splats = new AirgsSplats(app);
  app.root.addChild(splats.entity);
  placeInWorld(splats.entity, reader);
  firstView(app, reader, splats.entity);
  await play(reader, splats);
});
