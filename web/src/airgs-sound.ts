// What the player loads for a package with sound.
export { Sound } from "./play/sound.ts";
