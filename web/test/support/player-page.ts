// What pages that try the player share: a canvas, a player on it, and all that the player tells.
import { Player, type PlayerOptions, type Problem, type ViewState } from "../../src/airgs.ts";

export const query = new URLSearchParams(location.search);
export const src = query.get("src") ?? "";
export const number = (name: string, otherwise: number) => Number(query.get(name) ?? otherwise);

export const canvas = document.createElement("canvas");
document.body.append(canvas);
export const gl = () => canvas.getContext("webgl2") as WebGL2RenderingContext;

export const sleep = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));
export const shown = () => new Promise((resolve) => requestAnimationFrame(resolve));

let log: Log | null = null;

/** Resolves when a condition holds. Throws after a while. */
export async function until(what: string, condition: () => boolean, seconds = 40): Promise<void> {
  const end = performance.now() + 1e3 * seconds;
  while (!condition()) {
    if (performance.now() > end) throw new Error(`${what}: not within ${seconds} s; ${JSON.stringify(log?.report())}`);
    await sleep(20);
  }
}

/** Everything that a player tells, in order. */
export class Log {
  readonly events: string[] = [];
  readonly problems: Problem[] = [];
  readonly rungs: string[] = [];

  constructor(readonly player: Player) {
    for (const type of ["open", "firstpicture", "play", "pause", "stall", "resume", "ended", "lost", "restored"]) {
      player.on(type, () => this.events.push(type));
    }
    player.on("problem", (event) => this.problems.push((event as CustomEvent<Problem>).detail));
    player.on("rung", () => this.rungs.push(player.rungs[player.rung ?? 0].name));
  }

  has(type: string): boolean {
    return this.events.includes(type);
  }

  report() {
    const { events, problems, rungs, player } = this;
    const { stats, currentTime, duration, ended, paused } = player;
    const words = problems.map(({ message, fatal }) => ({ message, fatal }));
    return { events, problems: words, rungs, stats, currentTime, duration, ended, paused, error: gl().getError() };
  }
}

/** A player that has begun to play, as seen by `view`, by default from where the package says. */
export async function start(options: PlayerOptions = {}, view?: ViewState): Promise<Log> {
  const player = new Player(canvas, {
    policy: query.get("policy") ?? "robust-mpc",
    ...(query.has("kept") && { keptBytes: number("kept", 0) }),
    ...options,
  });
  log = new Log(player);
  player.resize(number("width", 160), number("height", 120));
  if (view) player.camera = view;
  player.play();
  await player.open(src);
  return log;
}
