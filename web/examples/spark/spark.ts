// A package in a scene of three.js, drawn by spark.
//
//     index.html?src=PACKAGE/[&rung=Q1+L0][&frame=12]      the last one stands still
import { SparkRenderer } from "@sparkjsdev/spark";
import { Matrix4, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { type FrameReader, openFrames } from "../../src/airgs-frames.ts";
import { AirgsSplats, SPARK_SETTINGS } from "./airgs-splats.ts";

type Twelve = [number, number, number, number, number, number, number, number, number, number, number, number];

const query = new URLSearchParams(location.search);
const canvas = document.querySelector("canvas")!;
const output = document.querySelector("output")!;

/** Puts splats where the package says that the scene stands; without that they stay in its own coordinates. */
function placeInWorld(splats: AirgsSplats, { world }: FrameReader): void {
  if (world) splats.applyMatrix4(new Matrix4().set(...(world.transform as Twelve), 0, 0, 0, 1));
}

/** A camera where the first place of the viewing region is, and what turns it round the focus of that place. */
function firstView(
  { region }: FrameReader,
  { matrix }: AirgsSplats,
): { camera: PerspectiveCamera; controls: OrbitControls } {
  const { position, focus, up } = region.places[0]!;
  const near = region.near * matrix.getMaxScaleOnAxis();
  const camera = new PerspectiveCamera(region.fov_y, 1, near, near * 1e6);
  camera.position.fromArray(position).applyMatrix4(matrix);
  camera.up.fromArray(up).transformDirection(matrix); // before the controls are made, which keep to it
  const controls = new OrbitControls(camera, canvas);
  controls.target.fromArray(focus).applyMatrix4(matrix);
  controls.update();
  return { camera, controls };
}

/** Draws picture after picture, in the size of the window. */
function draw(scene: Scene, renderer: WebGLRenderer, { camera, controls }: ReturnType<typeof firstView>): void {
  const fit = () => {
    renderer.setPixelRatio(devicePixelRatio);
    renderer.setSize(innerWidth, innerHeight, false);
    camera.aspect = innerWidth / innerHeight;
    camera.updateProjectionMatrix();
  };
  addEventListener("resize", fit);
  fit();
  renderer.setAnimationLoop(() => {
    controls.update();
    renderer.render(scene, camera);
  });
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
  const renderer = new WebGLRenderer({ canvas, antialias: false }); // splats have soft edges of their own
  const splats = new AirgsSplats();
  placeInWorld(splats, reader);
  const scene = new Scene();
  scene.add(new SparkRenderer({ renderer, ...SPARK_SETTINGS }), splats);
  draw(scene, renderer, firstView(reader, splats));
  await play(reader, splats);
}

main().catch((error) => {
  output.textContent = String(error);
});
