// What is heard of the player and the network, and what is shown of it.
import type { Problem } from "../play/playback.ts";
import type { Shell } from "./shell.ts";

const OFFLINE = "There is no network. Trying again …";
const LOST = "The graphics card has been taken away. Waiting for it …";
/** So long a trouble stays to be read when it is over. */
const READ_MS = 2500;

export class News {
  constructor(
    readonly shell: Shell,
    readonly fail: (error: unknown) => void,
  ) {}

  /** An event of the player. */
  hear(name: string, detail: unknown): void {
    const { shell } = this;
    if (name === "firstpicture") shell.showPicture();
    else if (name === "stall") shell.waiting = true;
    else if (name === "resume") shell.waiting = false;
    else if (name === "progress") this.online();
    else if (name === "lost") shell.notes.show("lost", LOST);
    else if (name === "restored") shell.notes.hide("lost");
    else if (name === "pause" || name === "ended") shell.stir();
    else if (name === "problem") this.#problem(detail as Problem);
  }

  offline(): void {
    this.shell.notes.show("network", OFFLINE);
  }

  online(): void {
    this.shell.notes.hide("network", READ_MS);
  }

  #problem({ message, fatal, error }: Problem): void {
    if (fatal) this.fail(error ?? new Error(message));
    else if (navigator.onLine) this.shell.notes.show("network", message);
    else this.offline();
  }
}
