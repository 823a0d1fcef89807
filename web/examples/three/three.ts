// A package in a scene of three.js, drawn by its own GaussianSplat: with WebGPU, or with WebGL 2 where that is not there.
import { openFrames } from "airgs-player/frames";
import { AirgsSplats } from "airgs-player/three";
import { LinearSRGBColorSpace, WebGPURenderer } from "three/webgpu";
import { canvas, play, run, src } from "../show.ts";
import { draw } from "../stage.ts";

run(async () => {
  const reader = await openFrames(src);
  const renderer = new WebGPURenderer({ canvas, alpha: false, antialias: false }); // splats have soft edges of their own
  renderer.outputColorSpace = LinearSRGBColorSpace; // their colours are blended as they are shown
  await renderer.init();
  const splats = new AirgsSplats();
  draw(renderer, reader, splats);
  await play(reader, splats);
});
