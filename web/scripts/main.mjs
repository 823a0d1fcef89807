// Builds the player: what pip installs and airgs-serve sends, into airgs_codec/serve/page/ (or the folder of the argument).
//
//     airgs.js          the player without controls, as a module: open, play, seek, on(…)
//     airgs-frames.js   frames as Gaussians, for other engines
//     airgs-player.js   <airgs-player>, with all of it
//     airgs-vr.js       what the player loads for a headset
//     airgs-more.js     what the element loads once there is a picture: keys, gestures, menu, figures and the like
//     airgs-sound.js    what the player loads for a package with sound
//     airgs-list.js     what the server's list of packages runs while scenes are encoded
//     player.html       a page with nothing but <airgs-player src="…">
import { copyFile, mkdir } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { bundle, bundleOnce } from "./bundle.mjs";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const folder = process.argv[2] ?? here("../../airgs_codec/serve/page");

await mkdir(folder, { recursive: true });
const parts = { "airgs-vr": "play/vr", "airgs-sound": "play/sound" };
for (const name of ["airgs", "airgs-frames", "airgs-player", "airgs-more", ...Object.keys(parts)])
  await bundleOnce(here(`../src/${parts[name] ?? name}.ts`), `${folder}/${name}.js`);
await bundle({ "airgs-list": here("../src/airgs-list.ts") }, folder, { minify: true });
await copyFile(here("../src/player.html"), `${folder}/player.html`);
