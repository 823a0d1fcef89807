// What the player loads when somebody puts on a headset.
export { enter } from "./play/vr.ts";
