// What a scene of three.js needs beside its splats, whoever draws them.
import type { FrameReader } from "airgs-player/frames";
import { type Camera, Matrix4, type Object3D, PerspectiveCamera, Scene } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

type Twelve = [number, number, number, number, number, number, number, number, number, number, number, number];

interface Renderer {
  domElement: HTMLElement;
  setPixelRatio(ratio: number): void;
  setSize(width: number, height: number, style: boolean): void;
  setAnimationLoop(draw: () => void): unknown;
  render(scene: Scene, camera: Camera): void;
}

/** Puts splats where the package says that the scene stands; without that they stay in its own coordinates. */
function placeInWorld(splats: Object3D, { world }: FrameReader): void {
  if (world) splats.applyMatrix4(new Matrix4().set(...(world.transform as Twelve), 0, 0, 0, 1));
}

/** A camera where the first place of the viewing region is, and what turns it round the focus of that place. */
function firstView(
  { region }: FrameReader,
  { matrix }: Object3D,
  canvas: HTMLElement,
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

/** Draws splats and what they need of a package in the size of the window, picture after picture. */
export function draw(renderer: Renderer, reader: FrameReader, splats: Object3D, ...others: Object3D[]): void {
  placeInWorld(splats, reader);
  const scene = new Scene().add(splats, ...others);
  const { camera, controls } = firstView(reader, splats, renderer.domElement);
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
