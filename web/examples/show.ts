// What examples have in common: where the package is, and its frames one after the other.
//
//     index.html?src=PACKAGE/[&rung=Q1+L0][&frame=7&frame=12]      those one after the other, the last stands still
import type { FrameReader, Gaussians } from "airgs-player/frames";

const PICTURES = 5; // of each frame that is asked for
const query = new URLSearchParams(location.search);
const output = document.querySelector("output")!;

export const canvas = document.querySelector("canvas")!;
export const src = query.get("src") ?? "./";

/** Shows the frames that are asked for, or all of them, each at its time, over and over again. */
export async function play(reader: FrameReader, splats: { show(gaussians: Gaussians): void }): Promise<void> {
  const stills = query.getAll("frame").map(Number);
  const rung = query.get("rung") ?? undefined;
  const show = (gaussians: Gaussians, frame: number) => {
    splats.show(gaussians);
    output.textContent = `frame ${frame + 1} of ${reader.frames}`;
  };
  if (!stills.length) await reader.play(show, { rung });
  for (const still of stills) {
    show(await reader.gaussians(still, rung), still);
    for (let i = 0; i < PICTURES; i++) await new Promise(requestAnimationFrame);
  }
}

export function run(main: () => Promise<void>): void {
  main().catch((error) => {
    output.textContent = String(error);
  });
}
