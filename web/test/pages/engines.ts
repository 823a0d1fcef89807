// Pictures of one frame from several cameras, drawn by spark or PlayCanvas through the adapters of examples/, for
// tools/lab/bench/engines.py to compare, and how long the adapters take to hand a frame over.
//
//     ?scene=FOLDER&engine=spark|playcanvas&variant=default|tuned      in FOLDER views.json, and rows.bin
import { SparkRenderer } from "@sparkjsdev/spark";
import * as pc from "playcanvas";
import * as THREE from "three";
import { AirgsSplats as PlayCanvasSplats, tuneGsplat } from "../../adapters/playcanvas.ts";
import { SPARK_SETTINGS, AirgsSplats as SparkSplats } from "../../adapters/spark.ts";
import type { Gaussians } from "../../src/format/types.ts";

interface View {
  position: [number, number, number];
  focus: [number, number, number];
  up: [number, number, number];
}

interface Scene {
  rows: number;
  channels: number;
  size: number;
  fov_y: number;
  near: number;
  views: View[];
}

interface Engine {
  show(gaussians: Gaussians): void;
  /** The picture of a view as RGBA, from the top, when the depth order is that of the view. */
  picture(view: View): Promise<Uint8Array>;
}

const SHOWN = 10; // times that a frame is handed over
const SETTLED = 3; // pictures until colours and depth order are those of a view
const query = new URLSearchParams(location.search);

const nextFrame = () => new Promise((resolve) => requestAnimationFrame(resolve));

async function read(folder: string): Promise<{ scene: Scene; gaussians: Gaussians }> {
  const scene: Scene = await (await fetch(`${folder}/views.json`)).json();
  const values = new Float32Array(await (await fetch(`${folder}/rows.bin`)).arrayBuffer());
  let at = 0;
  const take = (width: number) => {
    at += width * scene.rows;
    return values.slice(at - width * scene.rows, at);
  };
  const [means, quaternions, logScales] = [take(3), take(4), take(3)];
  return { scene, gaussians: { means, quaternions, logScales, alpha: take(1), colours: take(scene.channels) } };
}

/** Pixels of the bottom line first, as WebGL has them -> the top line first. */
function upright(pixels: Uint8Array, size: number): Uint8Array {
  const out = new Uint8Array(pixels.length);
  for (let y = 0; y < size; y++)
    out.set(pixels.subarray((size - 1 - y) * size * 4, (size - y) * size * 4), y * size * 4);
  return out;
}

function readBack(gl: WebGL2RenderingContext, size: number): Uint8Array {
  const pixels = new Uint8Array(size * size * 4);
  gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return upright(pixels, size);
}

function canvasOf(size: number): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = size;
  canvas.height = size;
  canvas.style.width = canvas.style.height = `${size}px`;
  document.body.append(canvas);
  return canvas;
}

function sparkEngine(scene: Scene, tuned: boolean): Engine {
  const renderer = new THREE.WebGLRenderer({ canvas: canvasOf(scene.size), antialias: false });
  const spark = new SparkRenderer({ renderer, ...(tuned ? SPARK_SETTINGS : {}) });
  const splats = new SparkSplats();
  const world = new THREE.Scene();
  world.add(spark, splats);
  const camera = new THREE.PerspectiveCamera(scene.fov_y, 1, scene.near, 1e4);
  const picture = async (view: View) => {
    camera.position.fromArray(view.position);
    camera.up.fromArray(view.up);
    camera.lookAt(...view.focus);
    camera.updateMatrixWorld();
    for (let i = 0; i < SETTLED; i++) {
      await spark.update({ scene: world, camera });
      while (spark.sorting || spark.sortDirty) await nextFrame();
      renderer.render(world, camera);
    }
    return readBack(renderer.getContext() as WebGL2RenderingContext, scene.size);
  };
  return { show: (gaussians) => splats.show(gaussians), picture };
}

function playCanvasEngine(scene: Scene, tuned: boolean): Engine {
  const canvas = canvasOf(scene.size);
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
  app.autoRender = false;
  app.setCanvasFillMode(pc.FILLMODE_NONE, scene.size, scene.size);
  app.setCanvasResolution(pc.RESOLUTION_FIXED, scene.size, scene.size);
  app.start();
  if (tuned && !tuneGsplat(app)) throw new Error("the kernel of PlayCanvas is another one");
  const camera = new pc.Entity("camera");
  camera.addComponent("camera", { clearColor: pc.Color.BLACK, fov: scene.fov_y, nearClip: scene.near, farClip: 1e4 });
  if (tuned) camera.camera!.toneMapping = pc.TONEMAP_NONE;
  app.root.addChild(camera);
  const splats = new PlayCanvasSplats(app);
  app.root.addChild(splats.entity);
  const gl = (app.graphicsDevice as unknown as { gl: WebGL2RenderingContext }).gl;
  const picture = async (view: View) => {
    camera.setPosition(...view.position);
    camera.lookAt(new pc.Vec3(view.focus), new pc.Vec3(view.up));
    let pixels = new Uint8Array();
    for (let i = 0; i < SETTLED; i++) {
      await new Promise<void>((resolve) => {
        app.once("frameend", () => {
          pixels = readBack(gl, scene.size) as Uint8Array<ArrayBuffer>;
          resolve();
        });
        app.renderNextFrame = true;
      });
      await new Promise((resolve) => setTimeout(resolve, 100)); // the worker sorts
    }
    return pixels;
  };
  return { show: (gaussians) => splats.show(gaussians), picture };
}

const base64 = (bytes: Uint8Array) => {
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
};

async function main() {
  const { scene, gaussians } = await read(query.get("scene")!);
  const tuned = query.get("variant") === "tuned";
  const engine = query.get("engine") === "spark" ? sparkEngine(scene, tuned) : playCanvasEngine(scene, tuned);
  engine.show(gaussians);
  const pictures: string[] = [];
  for (const view of scene.views) pictures.push(base64(await engine.picture(view)));
  const updateMs: number[] = [];
  for (let i = 0; i < SHOWN; i++) {
    const start = performance.now();
    engine.show(gaussians);
    updateMs.push(performance.now() - start);
    await nextFrame();
  }
  return { pictures, updateMs };
}

Object.assign(window, { report: main() });
