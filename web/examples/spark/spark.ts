// A package in a scene of three.js, drawn by spark.
import { SparkRenderer } from "@sparkjsdev/spark";
import { openFrames } from "airgs-player/frames";
import { AirgsSplats, SPARK_SETTINGS } from "airgs-player/spark";
import { WebGLRenderer } from "three";
import { canvas, play, run, src } from "../show.ts";
import { draw } from "../stage.ts";

run(async () => {
  const reader = await openFrames(src);
  const renderer = new WebGLRenderer({ canvas, antialias: false }); // splats have soft edges of their own
  const splats = new AirgsSplats();
  draw(renderer, reader, splats, new SparkRenderer({ renderer, ...SPARK_SETTINGS }));
  await play(reader, splats);
});
